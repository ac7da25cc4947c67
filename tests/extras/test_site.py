"""The site is built with every link checked, and the quickstart runs in a Jupyter kernel, robot included.

Needs the extra `site` in this Python.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = ROOT / "docs" / "quickstart.ipynb"
REFERENCE = ["open_workspace", "run", "WorkspaceView.why", "WorkspaceView.replay", "SessionView.trajectory", "Figure"]
pytestmark = [pytest.mark.extras, pytest.mark.journey]


@pytest.fixture(scope="module")
def build(tmp_path_factory):
    pytest.importorskip("mkdocs", reason="needs the extra `site`: make test-extras")
    folder = tmp_path_factory.mktemp("site")

    def run(config="mkdocs.yml"):
        command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", config, "-d", folder]
        environ = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
        return folder, subprocess.run(command, cwd=ROOT, env=environ, capture_output=True, text=True, check=False)

    return run


def test_the_site_is_built_and_holds_the_reference_from_docstrings(build):
    folder, done = build()
    assert done.returncode == 0, done.stderr
    page = (folder / "reference" / "library" / "index.html").read_text(encoding="utf-8")
    assert [name for name in REFERENCE if f'id="phyagentos.api.{name}"' not in page] == []
    assert "positions [rad; m of a sliding joint]" in re.sub(r"\s+", " ", re.sub(r"<[^>]+>", "", page))
    assert (folder / "quickstart.ipynb").read_bytes() == NOTEBOOK.read_bytes()


@pytest.mark.parametrize("link", ["[gone](gone.md)", "[gone](library.md#gone)", "[gone](../gone.py)"])
def test_a_link_that_leads_nowhere_ends_the_build(build, tmp_path, link):
    docs = tmp_path / "docs"
    docs.mkdir()
    for name in ("index.md", "library.md"):
        (docs / name).write_text(f"# Page\n\n{link if name == 'index.md' else ''}\n")
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[0]
    config = tmp_path / "mkdocs.yml"
    config.write_text(text.replace("docs_dir: docs", f"docs_dir: {docs}").replace("tools/", f"{ROOT}/tools/"))
    _, done = build(str(config))
    assert done.returncode == 1
    assert "gone" in done.stderr


def test_the_quickstart_runs_in_a_jupyter_kernel_with_its_robot(tmp_path):
    nbclient = pytest.importorskip("nbclient", reason="needs the extra `site`: make test-extras")
    import nbformat

    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    client = nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    shown = "".join(str(each.get("data", each.get("text"))) for each in outputs)
    assert "GRASP_LOST" in shown
    assert shown.count("data:image/svg+xml") == 1
    assert "<b>FAILURE</b>" in shown
    assert (tmp_path / "workspaces" / "demo" / "TASK.md").is_file()
