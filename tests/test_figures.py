"""Every figure of the docs can be made again, those of long experiments from their records."""

import json
import re
from pathlib import Path

import pytest

from benchmarks.redraw import DRAWN, MADE
from training.common.records import read_record, record_of, write_record

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
RECORDED = [name for name in DRAWN if record_of(DOCS / name).exists()]
PAGES = sorted([ROOT / "README.md", *DOCS.rglob("*.md")])
FIGURES = {
    (page.parent / name).resolve(): page
    for page in PAGES
    for name in re.findall(r"!\[[^]]*\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
}


@pytest.fixture(scope="module")
def made():
    """Return the figures, and folders of figures, that `make figures` writes."""
    target = re.search(r"^figures:.*?(?=^\S)", MAKEFILE, re.DOTALL | re.MULTILINE)[0]
    assert "benchmarks.redraw" in target
    return {DOCS / name for name in (*DRAWN, *MADE)} | {ROOT / name for name in re.findall(r"docs/[\w./-]+", target)}


def test_make_figures_makes_every_figure(made):
    folders = {*made, DOCS / "reference" / "effects" / "images"}
    assert [str(figure) for figure in FIGURES if not {figure, figure.parent} & folders] == []


def test_a_missing_record_is_measured_by_make():
    rules = [line for line in MAKEFILE.splitlines() if line.endswith(": | $(STAMP)")]
    missing = [f"docs/{name[:-3]}json" for name in DRAWN if name not in RECORDED]
    assert [record for record in missing if not any(record in line for line in rules)] == []


@pytest.mark.parametrize("name", RECORDED)
def test_a_record_states_command_and_commit_and_its_page_states_the_commit(name):
    record = json.loads(record_of(DOCS / name).read_text(encoding="utf-8"))
    page = FIGURES[DOCS / name].read_text(encoding="utf-8")
    assert re.fullmatch(r"[0-9a-f]{7,40}", record["commit"])
    assert record["commit"][:7] in page
    assert record["command"].startswith(("sonar-gym ", "python "))


@pytest.mark.parametrize("name", [*RECORDED, *MADE])
def test_a_figure_is_drawn_again(name):
    content = MADE[name]() if name in MADE else DRAWN[name](read_record(DOCS / name))
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    assert content[16:24] == (DOCS / name).read_bytes()[16:24]  # width and height


def test_a_record_is_rounded(tmp_path):
    written = write_record(tmp_path / "a.png", "1234567", "make it", {"x": [0.1234567, 12, float("nan")]})
    assert written["x"][:2] == [0.12346, 12]
    assert str(written) == str(read_record(tmp_path / "a.png"))
