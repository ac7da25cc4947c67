"""A ROS 2 robot behind the kit: every promise of the port, over the wires of two distributions."""

import pytest

from phyagentos.testing import DRIVER_CHECKS, DriverSubject
from tests.extras.ros2.cell import OTHER_HABITS, SCENE

pytestmark = pytest.mark.extras

OTHERS = {"begins_at_desired": False, "ignores_velocities": True}
ROBOTS = {
    "trajectories of all joints": {"hand": False},
    "from the measured state": {"controller": {"begins_at_desired": False}, "ros2": {"controller": {"stamp": "zero"}}},
    "other habits": {"hand": False, "habits": OTHER_HABITS, "controller": OTHERS},
    "positions, and a topic that stops": {"kind": "forward", "ros2": {"stop": {"topic": "stop"}}},
}


@pytest.fixture(params=["ros2", "ros2_jazzy"])
def python(request, find_python):
    return find_python(request.param)


def check_all(cell):
    """Each check with a fresh process of the kit before one robot."""
    passed = []
    for check in DRIVER_CHECKS:
        subject = DriverSubject(
            open=cell.reach, scene=SCENE, noise=0.01, set_stop=cell.set_stop,
            count_stops=lambda _client: cell.robot.ask("truth")["stops"], reset=lambda: cell.robot.ask("reset"),
        )  # fmt: skip
        check(subject)
        subject.close()
        passed.append(check.__name__)
        cell.robot.ask("reset")
        cell.set_stop(False)
    return passed


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_robot_does_what_the_port_promises(robot, python, make_cell):
    cell = make_cell(python, **ROBOTS[robot])
    passed, truth = check_all(cell), cell.robot.ask("truth")
    print(f"\n{robot}: {len(passed)} of {len(DRIVER_CHECKS)} at {truth['factor']:.2f} of real time, {truth['counts']}")  # noqa: T201
    assert len(passed) == len(DRIVER_CHECKS)
    assert truth["stops"] == 1, "the robot's own stop, once"
    assert set(truth["counts"]) <= {"taken", "in the past"}, "the controller took what it was sent"
