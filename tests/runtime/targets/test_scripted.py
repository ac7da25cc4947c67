"""A debug target: the wire, the authority and the receive log of any other, without physics."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.settings.runtime_contract import read_runtime_contract
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.runtime.actions.tool_point import ToolPoint
from phyagentos.runtime.drivers.debug import DebugDriver
from phyagentos.runtime.preflight.needs import iter_handshake_problems
from phyagentos.runtime.preflight.safety_limits import iter_live_safety_problems
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import Loopback

LIBRARY = Library((Path(__file__).resolve().parents[3] / "benchmarks" / "library",))


@pytest.fixture
def world(tmp_path):
    driver = DebugDriver(read_target(LIBRARY.get_target("counter")), LIBRARY)
    world = ServedTarget(driver, ReceiveLog(tmp_path / "log.jsonl"))
    world.handle(wire.LoadScene(scene="counter", seed=0, episode="e"))
    return world


def command(q: float, sequence: int = 1, session: str = "s", epoch: int = 1) -> wire.Command:
    return wire.Command(
        session=session,
        epoch=epoch,
        sequence=sequence,
        expires_at_s=1.0,
        q_rad=np.array([[q]]),
        qd_rad_s=np.zeros((1, 1)),
        gripper_width_m=np.zeros(1),
    )


def find_height(world) -> float:
    (mark,) = world.handle(wire.Observe(truth=True)).entities
    return mark.pose.position_m[2]


def test_it_stands_where_it_is_told_and_what_is_movable_rides_on_it(world):
    world.handle(wire.Begin(session="s", epoch=1))
    before = find_height(world)
    step = world.handle(command(0.02))

    assert (step.time_s, step.target.q_rad) == (0.02, (0.02,))
    assert find_height(world) == pytest.approx(before + 0.02)


@pytest.mark.parametrize("joints", [1, 3])
def test_it_tells_the_slide_that_it_is_so_that_the_guard_knows_where_a_command_ends(tmp_path, joints):
    profile = read_target(LIBRARY.get_target("counter"))
    arm = profile.arm.model_copy(update={"joints": tuple("abc"[:joints]), "home_rad": (0.0,) * joints})
    moved = profile.model_copy(update={"arm": arm, "mount_position_m": (0.1, 0.2, 0.3)})
    world = ServedTarget(DebugDriver(moved, LIBRARY), ReceiveLog(tmp_path / "log.jsonl"))
    world.handle(wire.LoadScene(scene="counter", seed=0, episode="e"))
    tool = ToolPoint(world.handle(wire.Describe()).kinematics)
    world.handle(wire.Begin(session="s", epoch=1))
    q = np.array([[0.25, -4.0, 7.0][:joints]])
    step = world.handle(msgspec.structs.replace(command(0.0), q_rad=q, qd_rad_s=np.zeros((1, joints))))

    assert step.target.tcp.position_m == pytest.approx(tool.compute(q[0]))


def test_it_leaves_nothing_open_that_preflight_asks_for(world):
    live, profile = world.handle(wire.Describe()), read_target(LIBRARY.get_target("counter"))
    contract = read_runtime_contract(find_shipped_root() / "protocol" / "runtime_contract.yaml")
    limits = read_safety(LIBRARY.roots[0] / "protocol" / "safety.yaml").targets["counter"]

    assert list(iter_handshake_problems(profile, contract, live)) == []
    assert list(iter_live_safety_problems(limits, profile, live)) == []


def test_it_answers_in_its_own_process_as_over_a_socket(world):
    channel = Loopback(world)
    assert not channel.poll()
    with pytest.raises(EOFError):
        channel.recv_bytes()
    channel.send_bytes(wire.REQUESTS.encode(wire.Describe()))

    assert channel.poll()
    assert wire.receive_reply(channel, 1.0).target == "counter"
