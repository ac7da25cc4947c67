"""The main example, unchanged, on a robot that is reachable over ROS 2 alone; the plant says what was reached.

Its clock runs as slowly as this machine needs for four cameras of 640 x 480 pixels. `--nightly` takes eleven
worlds, four of them of a robot with other habits.
"""

import json

import numpy as np
import pytest

from phyagentos.assembly.paths import TOKENS
from phyagentos.bench.suite import open_bench
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.workspace.workspace import Workspace
from tests.extras.ros2.cell import CAMERAS, CLOCK, OTHER_HABITS, OTHER_VIEWS, ROOT

pytestmark = [pytest.mark.extras, pytest.mark.journey]
GRAPH = ROOT / "goal_graphs" / "tidy_table.yaml"
COLORS = ("red", "green", "blue")
PACE, SLOW_HZ = 0.2, 2
WITH_OTHER_HABITS = range(8, 12)


def open_workspace(cell, folder):
    """A workspace whose panda is the cell's, with its key."""
    endpoint, profile = cell.serve(), cell.project / "robots" / "panda" / "target.yaml"
    assert endpoint.startswith("ws://"), endpoint
    profile.write_text(profile.read_text().replace("ws://127.0.0.1:1", endpoint))
    workspace = Workspace.create(folder, Library.open(cell.project))
    secret = workspace.root / TOKENS / "panda"
    secret.parent.mkdir(parents=True)
    secret.touch(mode=0o600)
    secret.write_text(cell.key.hex())
    return workspace


def count_cubes(cell, truth):
    """How many stand in the tray of their colour, by the plant's own state."""
    interiors = json.loads((cell.folder / "plant" / "plant.json").read_text())["interiors"]
    found = 0
    for color in COLORS:
        center, half = map(np.array, interiors[f"{color}_tray"])
        away = np.subtract(truth["bodies"][f"{color}_cube"], truth["bodies"][f"{color}_tray"]) - center
        found += bool((np.abs(away)[:2] < half[:2]).all() and abs(away[2]) < half[2])
    return found


@pytest.mark.parametrize("seed", range(1, 12))
def test_the_table_is_tidied_over_ros(seed, make_cell, tmp_path, pytestconfig):
    if seed > 1 and not pytestconfig.option.nightly:
        pytest.skip("several minutes a world: --nightly")
    habits = {"views": OTHER_VIEWS, "habits": OTHER_HABITS, "camera_hz": SLOW_HZ} if seed in WITH_OTHER_HABITS else {}
    cell = make_cell(cameras=CAMERAS, pace=PACE, seed=seed, **habits)
    workspace = open_workspace(cell, tmp_path / "w")
    with open_bench(workspace, CLOCK) as agent:
        report = agent.mission.run(GRAPH, seed=seed, goal="tidy")
    truth = cell.robot.ask("truth")
    cubes, sessions = count_cubes(cell, truth), [f"{each.id} {each.verdict or each.state}" for each in report.sessions]
    factor = f"{truth['factor']:.2f} of real time"
    print(f"\nseed {seed}: {cubes} of 3 cubes, {report.verdict}, {factor}; {'; '.join(sessions)}")  # noqa: T201

    assert cubes == len(COLORS)
    assert report.verdict == "success"
    assert abs(truth["bodies"]["bottle"][2] - 0.07) < 0.01, "the bottle stands"
