"""Links and paths in the documentation lead somewhere."""

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
PACKAGES = sorted((ROOT / "docs" / "how-to" / "change-the-code").glob("*.md"))
NOTEBOOKS = sorted((ROOT / "docs").rglob("*.ipynb"))
MAX_PAGE, MAX_DOCS = 1500, 25_000  # words


def prose(path):
    """Return the text of a page or of a notebook without code, targets of links and formulas."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        text = "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"<!--.*?-->|\$\$.*?\$\$|(?<=\])\([^)]*\)", "", text, flags=re.DOTALL)


def n_words(path):
    return len(re.findall(r"\S*[A-Za-z]\S*", prose(path)))


def test_pages_are_short_and_few():
    words = {str(path.relative_to(ROOT)): n_words(path) for path in [*PAGES[1:], *NOTEBOOKS]}
    assert {name: n for name, n in words.items() if n > MAX_PAGE} == {}
    assert sum(words.values()) <= MAX_DOCS


def test_the_readme_has_a_hundred_lines():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 100


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_relative_links_resolve(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    links = re.findall(r"\]\(([^)#\s]+)", text)
    missing = [link for link in links if "://" not in link and not (page.parent / link).exists()]
    assert not missing


@pytest.mark.parametrize("page", PACKAGES, ids=lambda page: page.stem)
def test_paths_of_the_package_pages_exist(page):
    paths = re.findall(r"`((?:[\w.]+/)*(?:\w+\.py|\w+/))`", page.read_text(encoding="utf-8"))
    roots = (ROOT, ROOT / page.stem)
    assert paths
    missing = [path for path in paths if not any((root / path).exists() for root in roots)]
    assert not missing


def test_every_room_is_on_its_package_page():
    for page in PACKAGES:
        rooms = {p.parent.name for p in (ROOT / page.stem).glob("*/__init__.py")}
        assert rooms <= set(re.findall(r"`(\w+)/`", page.read_text(encoding="utf-8")))


@pytest.mark.parametrize("page", [page for page in PAGES[1:] if "![" in page.read_text()], ids=lambda page: page.stem)
def test_a_page_with_figures_states_commit_and_command(page):
    text = page.read_text(encoding="utf-8")
    assert re.search(r"\b(?:commit|at) [0-9a-f]{7,40}\b", text, re.IGNORECASE)
    assert re.search(r"(?:sonar-gym|python -m|make) [\w-]+|examples/\w+\.py", text)
