"""What a session does about another robot in its way: it waits, it gives way, it gives up; never for ever."""

import json

import msgspec
import numpy as np
import pytest

from phyagentos.runtime.execution.planning import STOOD_MAX_S, WAIT_S, WAITED_MAX_S
from phyagentos.runtime.targets import wire

TREE = ["plan_grasp: {object: red_cube, approaches: $ways}", "move_to: {approaches: $ways, approach: $down}"]
AHEAD, BEHIND = "arm_of_others", "zealous_arm"  # in the order of names, beside `panda`


@pytest.fixture
def crowded(doubles, profile):
    """A target in a shared world; `blocks` says of a motion's last posture whether another robot is in its way."""

    class Crowded(doubles.PerfectTarget):
        def __init__(self, name, blocks, *, moves=False, touched_n=None):
            super().__init__(profile, [doubles.make_cube()])
            self.name, self.blocks, self.moves, self.touched_n = name, blocks, moves, touched_n or {}

        def handle(self, request):
            if isinstance(request, wire.Announce):
                self.requests.append(request)
                return wire.Admission(self.name if self.blocks(self, request.q_rad[-1]) else "")
            return super().handle(request)

        def _describe(self):
            return msgspec.structs.replace(super()._describe(), shares_time=True)

        def _observe(self):
            way = np.tile(self.q, (3, 1)) if self.moves else np.empty((0, 7))
            return msgspec.structs.replace(
                super()._observe(), neighbours=(wire.Neighbour(self.name, self._state(), way),)
            )

        def _step(self):
            return msgspec.structs.replace(super()._step(), touched_n=self.touched_n)

    return Crowded


def goes_home(target, q_rad):
    return bool(np.allclose(q_rad, target.profile.arm.home_rad))


@pytest.fixture
def run(build_bench, session, plant):
    def carry_out(target):
        bench = build_bench(target, library=plant(TREE))
        return bench.run(session), bench

    return carry_out


def test_it_holds_still_while_time_passes_and_goes_on_once_the_way_is_clear(crowded, run):
    times = []

    def until_a_second_has_passed(target, _):
        times.append(target.time_s)
        return target.time_s < 1.0

    execution, bench = run(target := crowded(AHEAD, until_a_second_has_passed))

    assert (execution.ended, execution.code) == ("completed", "")
    assert np.diff(times) == pytest.approx(WAIT_S, abs=0.021)
    waited = [command for command in target.commands() if command.q_rad[-1][0] == pytest.approx(0.0, abs=1e-12)]
    assert len(waited) == pytest.approx(1.0 / 0.02, abs=6)
    assert len([each for each in bench.planner.requests if type(each).__name__ == "PlanMove"]) == len(times)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "moves", "limit_s"),
    [(AHEAD, False, STOOD_MAX_S), (AHEAD, True, WAITED_MAX_S), (BEHIND, False, WAITED_MAX_S)],
)
def test_of_two_that_wait_for_each_other_the_later_gives_way_and_none_waits_for_ever(
    crowded, run, name, moves, limit_s
):
    execution, _ = run(target := crowded(name, lambda *_: True, moves=moves))

    assert (execution.ended, execution.code) == ("skill_failed", "MOTION_CONFLICT")
    assert name in execution.message
    assert 2 * limit_s < target.time_s < 2.2 * limit_s + 1.0  # for its own way, then for the way home


def test_what_gives_way_goes_home_before_it_fails(crowded, run, doubles):
    target = crowded(AHEAD, lambda target, q: not goes_home(target, q))
    target.q = target.q_d = np.array(target.profile.arm.home_rad) + 0.1
    execution, _ = run(target)

    assert execution.code == "MOTION_CONFLICT"
    assert goes_home(target, target.commands()[-1].q_rad[-1])
    assert target.time_s < STOOD_MAX_S + 3.0


def test_contacts_with_another_robot_are_events_of_the_bundle(crowded, run):
    _, bench = run(crowded(AHEAD, lambda *_: False, touched_n={AHEAD: 12.3456}))
    lines = (bench.workspace / "evidence/tidy-1.red/events.jsonl").read_text().splitlines()
    touches = [event for event in map(json.loads, lines) if event["kind"] == "robot_contact"]

    assert touches
    assert {(each["details"]["robot"], each["details"]["force_n"]) for each in touches} == {(AHEAD, 12.346)}
