"""Cells with an emulated robot in the environment of `--ros2-python`, each in a DDS domain of its own."""

import itertools
import os
from pathlib import Path

import pytest

from tests.extras.ros2.cell import Cell, write_project

DOMAINS = itertools.count(os.getpid())  # of each process its own, as far as 101 go


@pytest.fixture(scope="session")
def find_python(pytestconfig):
    """The interpreter of `ros2` or `ros2_jazzy`."""

    def find(name="ros2"):
        path = getattr(pytestconfig.option, f"{name}_python")
        if path is None or not Path(path).exists():
            pytest.skip(f"no build/{name}, for which python3.11 is needed: `make test-extras`")
        return path

    return find


@pytest.fixture
def make_cell(tmp_path, pytestconfig, find_python):
    made = []

    def make(python=None, *, project=None, **options):
        domain = next(DOMAINS) % 101
        folder = tmp_path / f"cell{len(made)}"
        folder.mkdir()
        if project is None:
            project = folder / "project"
            project.mkdir()
            parts = {name: options[name] for name in ("kind", "hand", "views", "camera_hz") if name in options}
            write_project(project, cameras=options.get("cameras", ()), **parts, **options.pop("ros2", {}))
        given = {"cameras": (), **options}
        made.append(Cell(folder, project, python or find_python(), domain, **given))
        return made[-1]

    yield make
    for cell in made:
        assert set(cell.close()) <= {0}
