"""The safety guard's cost, and that it refuses what is hostile and nothing that is legitimate.

    python benchmarks/guard.py --seeds 10

Legitimate commands are those of `tidy_table`, run here in the simulator without and with faults, and repeated for the
clock. Hostile ones are made of them: one number changed, or the whole command. The collision stage is timed apart.
"""

import time
from collections import Counter
from collections.abc import Iterator, Sequence

import msgspec
import numpy as np

from benchmarks.recorded import Recording, Robot, open_robot, record_tidy_table
from benchmarks.runner import finish, run, show, show_figures
from benchmarks.safety_parts.hostile import iter_spoilt
from phyagentos.bench.report import Threshold
from phyagentos.protocol.capabilities.action_spaces import ActionSpace, GripperRange, describe_target_space
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.settings.safety import as_numbers
from phyagentos.protocol.world.faults import read_faults
from phyagentos.runtime.actions.bridges.chain import BridgeChain, Bridged, compile_chain
from phyagentos.runtime.actions.collision import PostureCollision
from phyagentos.runtime.actions.guard import SafetyGuard
from phyagentos.runtime.actions.set_points import SetPoints
from phyagentos.runtime.targets.wire import Command

ASKED = {
    "guard_us_median": Threshold(50.0, at_least=False),
    "legitimate_refused": Threshold(0.0, at_least=False),
    "hostile_passed": Threshold(0.0, at_least=False),
    "collision_false_refusals": Threshold(0.0, at_least=False),
}
FAULTS = find_shipped_root() / "faults" / "one_random.yaml"
HOSTILE_EACH = 40  # commands of every session that are spoilt in every way


def make_hostile(command: Command, rng: np.random.Generator) -> Iterator[tuple[str, Command]]:
    """The same command, spoilt in every way there is; `rng` chooses rows, joints and sizes."""
    change = msgspec.structs.replace
    points = SetPoints(command.q_rad, command.qd_rad_s, command.gripper_width_m)
    for name, bad in iter_spoilt(points, rng):
        yield name, change(command, q_rad=bad.q_rad, qd_rad_s=bad.qd_rad_s, gripper_width_m=bad.gripper_width_m)
    for name, expires_at_s in (("expired", command.expires_at_s - 1.0), ("never expires", np.inf), ("NaN", np.nan)):
        yield name, change(command, expires_at_s=expires_at_s)


def judge_recordings(robot: Robot, recordings: Sequence[Recording]) -> tuple[int, int, Counter[str], list[float]]:
    """Let the guard see every session as it was, with hostile commands in between.

    Returns:
        Legitimate commands refused; hostile ones passed; hostile ones by name; cost of the legitimate ones [us].
    """
    rng = np.random.default_rng(0)
    refused, passed, sent, costs = 0, 0, Counter[str](), list[float]()
    for recording in recordings:
        guard = SafetyGuard(robot.limits, recording.description)
        guard.begin(np.asarray(recording.q_rad))
        spoil = {int(index) for index in rng.integers(0, max(len(recording.commands), 1), HOSTILE_EACH)}
        for index, (command, now) in enumerate(recording.commands):
            for name, hostile in make_hostile(command, rng) if index in spoil else ():
                sent[name] += 1
                passed += guard.judge(hostile, now).command is not None
            began = time.perf_counter()
            ruling = guard.judge(command, now)
            costs.append(1e6 * (time.perf_counter() - began))
            refused += ruling.command is None
            if ruling.violation is not None:
                print(ruling.violation.code, ruling.violation)
    return refused, passed, sent, costs


def judge_collisions(robot: Robot, recordings: Sequence[Recording]) -> tuple[int, list[float]]:
    """False refusals of the collision stage over the commanded postures, and its cost [us]."""
    limit = robot.limits.collision_depth_max
    stage = PostureCollision(robot.profile, robot.folder, min(as_numbers(limit)) if limit is not None else 0.0)
    found, costs = Counter[str](), list[float]()
    for recording in recordings:
        open_m = robot.profile.gripper.max_width_m
        stage.update(recording.entities, np.asarray(recording.q_rad), open_m)
        for command, _ in recording.commands:
            began = time.perf_counter()
            contact = stage.find_contact(command.q_rad[-1], float(command.gripper_width_m[-1]))
            costs.append(1e6 * (time.perf_counter() - began))
            found[contact] += bool(contact)
    for pair, count in found.items():
        if count:
            print("collision stage:", pair, count)
    return found.total(), costs


def time_chain(robot: Robot, count: int = 2000) -> tuple[BridgeChain, float]:
    """A chain of four bridges, and its cost per command of the target [us]."""
    target = describe_target_space(robot.profile)
    source = ActionSpace(
        representation="joint_position",
        joints=tuple(reversed(target.joints)),
        angle_unit="deg",
        rate_hz=10.0,
        chunk_length=16,
        gripper=GripperRange(closed=1.0, open=0.0),
    )
    chain = compile_chain(source, target)
    assert isinstance(chain, BridgeChain)
    home = np.array([*robot.profile.arm.home_rad, 0.08])
    rows = np.tile([*np.degrees(home[6::-1]), 0.0], (16, 1))
    costs = []
    for _ in range(count):
        began = time.perf_counter()
        bridged = chain.apply(rows, home)
        costs.append(1e6 * (time.perf_counter() - began))
        assert isinstance(bridged, Bridged)
    return chain, float(np.median(costs)) / len(bridged.rows)


def main(*, seeds: int = 10) -> int:
    """Print the table and the closing line."""
    numbers = range(1, seeds + 1)
    robot = open_robot()
    plain = record_tidy_table(robot, numbers)
    faulty = record_tidy_table(robot, numbers, read_faults(FAULTS))
    recordings = [*plain, *faulty]
    refused, passed, sent, costs = judge_recordings(robot, recordings)
    false_refusals, collision_us = judge_collisions(robot, plain)
    chain, chain_us = time_chain(robot)
    figures = {
        "sessions": float(len(recordings)),
        "legitimate": float(len(costs)),
        "legitimate_refused": float(refused),
        "hostile": float(sent.total()),
        "hostile_passed": float(passed),
        "guard_us_median": float(np.median(costs)),
        "guard_us_p99": float(np.quantile(costs, 0.99)),
        "collision_us_median": float(np.median(collision_us)),
        "collision_false_refusals": float(false_refusals),
        "bridges_us_per_command": chain_us,
    }
    show_figures("Safety guard, one command of ten rows and seven joints", figures, ASKED)
    show("not among the figures", ("", ""), (("hostile kinds", ", ".join(sorted(sent))), ("bridges timed", chain)))
    return finish(figures, ASKED)


if __name__ == "__main__":
    run(main)
