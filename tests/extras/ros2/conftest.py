"""Cells with an emulated robot in the environment of `--ros2-python`, each in a DDS domain of its own."""

import itertools

import pytest

from tests.extras.ros2.cell import Cell, write_project

DOMAINS = itertools.count(1)


@pytest.fixture
def make_cell(tmp_path, pytestconfig):
    made = []

    def make(python=None, *, project=None, **options):
        domain = (next(DOMAINS) + 20 * _find_worker(pytestconfig)) % 101
        folder = tmp_path / f"cell{len(made)}"
        folder.mkdir()
        if project is None:
            project = folder / "project"
            project.mkdir()
            parts = {name: options[name] for name in ("kind", "hand") if name in options}
            write_project(project, cameras=options.get("cameras", ()), **parts, **options.pop("ros2", {}))
        given = {"cameras": (), **options}
        made.append(Cell(folder, project, python or pytestconfig.option.ros2_python, domain, **given))
        return made[-1]

    yield make
    for cell in made:
        assert set(cell.close()) <= {0}


def _find_worker(config):
    return int(getattr(config, "workerinput", {}).get("workerid", "gw0")[2:]) + 1
