"""The tutorials run from top to bottom, on small settings; what is stored in them was made on the full ones."""

import os
import re
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "tutorials"
SMALL = {
    "park-with-ppo": "steps, streets = 20_000, 20",
    "simulator-and-log": "pings = 10",
    "record": 'driver, epochs = "twin", 10',
}
DRAWS = re.compile(r"plt\.figure\(|\.plot\(\)|Image\(|^film\(", re.MULTILINE)
pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]


def is_parameters(cell):
    return "parameters" in cell.metadata.get("tags", [])


def without_picture(book):
    """Return the code that draws and left no picture."""
    shown = [[kind for out in cell.get("outputs", []) for kind in out.get("data", {})] for cell in book.cells]
    return [
        cell.source
        for cell, kinds in zip(book.cells, shown, strict=True)
        if cell.cell_type == "code" and DRAWS.search(cell.source) and "image/png" not in kinds
    ]


@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("*.ipynb")))
def test_a_tutorial_runs(name, tmp_path, monkeypatch):
    import nbformat
    from nbclient import NotebookClient

    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.delenv("MPLBACKEND")  # that of the tests shows nothing in a notebook
    book = nbformat.read(FOLDER / f"{name}.ipynb", 4)
    (cell,) = [cell for cell in book.cells if is_parameters(cell)]
    cell.source = SMALL[name]
    NotebookClient(book, timeout=1100, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert without_picture(book) == []


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_stored_tutorial_was_run_and_has_its_pictures(path):
    import nbformat

    book = nbformat.read(path, 4)
    assert all(cell.execution_count for cell in book.cells if cell.cell_type == "code")
    assert without_picture(book) == []
