"""Links and paths in the documentation lead somewhere."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
PACKAGES = sorted((ROOT / "docs" / "packages").glob("*.md"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_relative_links_resolve(page):
    links = re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8"))
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
