from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def test_there_are_notebooks():
    assert NOTEBOOKS


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_prints_what_it_shows(path, monkeypatch):
    """Every cell runs without an error or a warning, and the stored text is what comes out."""
    monkeypatch.delenv("MPLBACKEND", raising=False)  # the notebook's own draws into the page
    stored = nbformat.read(path, as_version=4)
    fresh = nbformat.read(path, as_version=4)
    NotebookClient(
        fresh, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(FOLDER)}}
    ).execute()
    for old, new in zip(stored.cells, fresh.cells, strict=True):
        if new.cell_type == "code":
            assert _text(new, "stderr") == ""
            assert _text(new, "stdout") == _text(old, "stdout")
            assert _pictures(new) == _pictures(old)


def _text(cell, stream):
    return "".join(o.text for o in cell.outputs if o.get("name") == stream)


def _pictures(cell):
    return sum("image/png" in o.get("data", {}) for o in cell.outputs)
