"""The tutorials run from top to bottom, on small settings; what is stored in them was made on the full ones."""

import os
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "tutorials"
SMALL = {
    "park-with-ppo": "steps, streets = 20_000, 20",
    "simulator-and-log": "pings = 10",
    "record": 'driver, epochs = "twin", 10',
}
pytestmark = [pytest.mark.slow, pytest.mark.timeout(1200)]


def is_parameters(cell):
    return "parameters" in cell.metadata.get("tags", [])


@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("*.ipynb")))
def test_a_tutorial_runs(name, tmp_path, monkeypatch):
    import nbformat
    from nbclient import NotebookClient

    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    book = nbformat.read(FOLDER / f"{name}.ipynb", 4)
    (cell,) = [cell for cell in book.cells if is_parameters(cell)]
    cell.source = SMALL[name]
    NotebookClient(book, timeout=1100, resources={"metadata": {"path": str(tmp_path)}}).execute()
    kinds = {kind for cell in book.cells for out in cell.get("outputs", []) for kind in out.get("data", {})}
    assert "image/png" in kinds


def test_the_stored_tutorials_have_pictures():
    for path in FOLDER.glob("*.ipynb"):
        assert '"image/png"' in path.read_text(), path.name
