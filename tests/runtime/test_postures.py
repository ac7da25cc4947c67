"""Named postures: refused with the nearest name or with what touches, reached on physics, judged by measured joints."""

import msgspec
import numpy as np
import pytest

from phyagentos.agent.judging.judges.predicates import PredicateJudge
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.protocol.sessions.evidence import read_bundle
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.process import LocalPlanner
from phyagentos.runtime.motion.profile_checks import check_profile
from phyagentos.runtime.perception.world_model import WORLD, GroundTruthWorldModel
from phyagentos.runtime.preflight.arguments import iter_posture_problems
from phyagentos.runtime.preflight.dry_run import DryRun
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.testing import ManualClock

ASIDE = (1.2, -0.5, 0.1, -2.0, 0.0, 1.6, 0.5)
FLOOR = (0.0, 1.6, 0.0, -0.3, 0.0, 1.5, 0.0)  # stretched out, through the table


@pytest.fixture(scope="module")
def profile():
    profile, _ = read_profile(Library.open().get_target("panda"))
    return profile.model_copy(update={"postures": {"aside": ASIDE, "floor": FLOOR}})


@pytest.fixture
def ask(build_session):
    def ask(posture):
        accept = (f"in_posture(target, {posture})",)
        parameters = {"posture": posture, "hold_s": 0.5}
        return build_session(skill="reach_posture", parameters=parameters, accept=accept)

    return ask


@pytest.fixture
def open_bench(build_bench, profile, library):
    """A runner on a simulated arm with these postures, and its driver."""

    def open_bench():
        driver = MujocoDriver(SimulatedWorld(library), profile, library.get_target("panda").parent)
        planner = LocalPlanner(MotionPlanner.open(library.get_target("panda")))
        return build_bench(ServedTarget(driver, ReceiveLog(None)), planner, clock=SystemClock()), driver

    return open_bench


def test_an_unknown_posture_is_refused_with_the_nearest_name(ask, profile, library):
    skill, _ = read_skill(library.get_skill("reach_posture"))
    assert list(iter_posture_problems(ask("aside"), skill, profile)) == []
    problems = list(iter_posture_problems(ask("asid"), skill, profile))
    assert [(each.label, each.address) for each in problems] == [
        ("UNKNOWN_NAME (posture)", "parameters.posture"),
        ("UNKNOWN_NAME (posture)", "accept[0]"),
    ]
    assert "expected aside, floor; required by target panda: postures. Did you mean 'aside'?" in str(problems[0])


@pytest.mark.sim
@pytest.mark.motion
def test_a_posture_through_the_table_is_refused_before_anything_moves(open_bench, ask, profile, library, registry):
    bench, _ = open_bench()
    bench.handle.load(ask("aside").scene)
    world = GroundTruthWorldModel("panda", bench.handle, profile=profile)
    world.enter(ask("aside").scene)
    dry_run = DryRun(
        planner=bench.planner,
        library=library,
        registry=registry,
        clock=ManualClock(),
        home_rad=profile.arm.home_rad,
        reach=None,
        postures=profile.postures,
    )
    assert dry_run.run(ask("aside"), "reach_posture", world.observe(WORLD), thorough=False)[-1].outcome == "possible"
    trial = dry_run.run(ask("floor"), "reach_posture", world.observe(WORLD), thorough=False)[-1]
    assert (trial.motion, trial.outcome, trial.code) == ("floor posture", "impossible", "IN_COLLISION")


@pytest.mark.sim
@pytest.mark.motion
def test_a_posture_is_reached_on_physics_and_judged_by_the_measured_joints(open_bench, ask):
    bench, driver = open_bench()
    session = ask("aside")
    execution = bench.run(session)

    assert execution.ended is Ended.COMPLETED, execution
    assert np.abs(driver.physics.data.qpos[driver.physics.state.q_address] - ASIDE).max() < 0.01
    bundle = read_bundle(bench.workspace / execution.evidence, session, execution)
    (criterion,) = PredicateJudge().judge(bundle)
    assert (criterion.truth, criterion.measured["off_rad"] < 0.01) == (Truth.TRUE, True)
    state = bundle.after.targets["panda"]
    moved = msgspec.structs.replace(state, q_rad=(state.q_rad[0] + 0.06, *state.q_rad[1:]))
    after = msgspec.structs.replace(bundle.after, targets={"panda": moved})
    (criterion,) = PredicateJudge().judge(msgspec.structs.replace(bundle, after=after))
    assert criterion.truth is Truth.FALSE


@pytest.mark.sim
@pytest.mark.parametrize(
    ("postures", "code"),
    [
        ("{aside: [1.2, -0.5, 0.1, -2.0, 0.0, 1.6]}", "INVALID_VALUE"),
        ("{aside: [3.2, -0.5, 0.1, -2.0, 0.0, 1.6, 0.5]}", "INVALID_VALUE"),
        ("{folded: [0.0, -1.7, 0.0, -3.0, 0.0, 0.0, 0.0]}", "IN_COLLISION"),
    ],
)
def test_a_posture_that_cannot_be_is_found_at_its_line(tmp_path, library, postures, code):
    for file in library.get_target("panda").parent.iterdir():
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    path = tmp_path / "target.yaml"
    path.write_text(path.read_text() + f"postures: {postures}\n")
    problems = check_profile(path, read_safety(library.roots[-1] / "protocol" / "safety.yaml"))
    assert {each.code for each in problems} == {code}
    assert all(f"target.yaml:{len(path.read_text().splitlines())}:" in each.address for each in problems)
