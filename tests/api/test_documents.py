"""The pages and the notebook about the library run as they stand, on a recorded workspace."""

import hashlib
import json
from pathlib import Path

import pytest

from tests.api.notebooks import execute, read_cells

DOCS = Path(__file__).resolve().parents[2] / "docs"
NOTEBOOK = DOCS / "quickstart.ipynb"
EPISODES = DOCS / "episodes.ipynb"


@pytest.fixture
def beside_demo(stored, monkeypatch):
    monkeypatch.chdir(stored.parents[1])


def test_the_quickstart_runs_from_top_to_bottom(beside_demo):
    shown = execute(NOTEBOOK)
    whole = "\n".join(shown)
    assert "GRASP_LOST" in whole
    assert whole.count("data:image/svg+xml") == 1
    assert "<b>FAILURE</b>" in whole
    assert all(shown[2:]), "each cell behind the first two shows something"


def test_the_quickstart_keeps_no_results_that_could_be_out_of_date():
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    assert (notebook["nbformat"], notebook["nbformat_minor"] >= 5) == (4, True)
    for cell in notebook["cells"]:
        assert cell["id"]
        assert cell["cell_type"] == "markdown" or (cell["outputs"], cell["execution_count"]) == ([], None)


def test_the_analysis_of_thirty_episodes_shows_what_its_cells_have_shown():
    notebook, cells = json.loads(EPISODES.read_text(encoding="utf-8")), read_cells(EPISODES)
    assert notebook["metadata"]["executed"] == hashlib.sha256("\n".join(cells).encode()).hexdigest()
    shown = [cell["outputs"] for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert all(shown[1:]), "python tools/execute_notebook.py docs/episodes.ipynb"
    whole = json.dumps(shown)
    assert (whole.count("/15 = "), whole.count("data:image/jpeg") >= 2) == (5, True)


@pytest.mark.slow
def test_the_examples_of_the_page_run(carried, beside_demo, asked):
    execute(DOCS / "library.md")
    assert [(order.graph.name, order.seed) for order in asked] == [("tidy_table", 7)]


def test_a_cell_that_fails_is_named(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```python\nx = 1\nx\n```\nText.\n```python\nx + 1\nraise KeyError(x)\n```\n")
    assert len(read_cells(page)) == 2
    with pytest.raises(KeyError) as failed:
        execute(page)
    assert failed.value.__notes__ == [f"in cell 2 of {page}"]
