"""Look-ahead on contact physics: what is rehearsed is what would happen, and nothing that only the true world knows."""

import dataclasses

import msgspec
import mujoco
import numpy as np
import pytest
from rollout_forecaster.estimate import believe_scene, stand_up_sunk
from rollout_forecaster.forecaster import BATCH, RolloutForecaster
from rollout_forecaster.playback import Playback, SharedPrefix, find_cause
from rollout_forecaster.rehearsal import Rehearser
from rollout_forecaster.uncertainty import ImaginedStart, draw_start
from scipy.spatial.transform import Rotation

from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.lookahead import LookaheadRequest
from phyagentos.protocol.sessions.session import Ended, Scene
from phyagentos.protocol.sessions.strategy import Strategy
from phyagentos.protocol.world.environment import Pose
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
from phyagentos.runtime.execution.leaf_registry import build_registry
from phyagentos.runtime.lookahead.forecaster import Case
from phyagentos.runtime.lookahead.service import ForecastService
from phyagentos.runtime.models.scene import draw_bodies
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.process import LocalPlanner
from phyagentos.runtime.perception.world_model import WORLD, GroundTruthWorldModel
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import Loopback
from phyagentos.testing import make_contract

pytestmark = [pytest.mark.sim, pytest.mark.motion]

WAITER, SEED = "tabletop/waiter", 7


@pytest.fixture(scope="module")
def rehearser(library, profile, limits):
    path = library.get_target("panda")
    return Rehearser(
        profile=profile,
        folder=path.parent,
        limits=limits,
        library=library,
        registry=build_registry(library),
        planner=LocalPlanner(MotionPlanner.open(path)),
        clock=SystemClock(),
    )


@pytest.fixture(scope="module")
def environment(library, profile, limits):
    driver = MujocoDriver(SimulatedWorld(library), profile, library.get_target("panda").parent)
    handle = TargetSessionHandle(Loopback(ServedTarget(driver, ReceiveLog(None))), limits, sees_truth=True)
    scene = Scene(name=WAITER, seed=SEED, episode="e")
    handle.load(scene)
    truth = GroundTruthWorldModel("panda", handle)
    truth.enter(scene)
    return truth.observe(WORLD)


@pytest.fixture(scope="module")
def session():
    return make_contract(
        parameters={"object": "coaster", "destination": "tray"},
        accept=("inside(coaster, tray)", "on(coin, coaster)"),
        scene=Scene(name=WAITER, seed=SEED, episode="e"),
        seed=11,
    )


@pytest.fixture(scope="module")
def stage(rehearser, environment):
    return rehearser.open_stage(environment)


@pytest.fixture(scope="module")
def rehearsal(rehearser, stage, session):
    return rehearser.rehearse(stage, session, "pick_and_place")


@pytest.fixture(scope="module")
def result(rehearser, session, environment):
    request = LookaheadRequest(samples=8, threshold=0.8, seed=5)
    return foresee(rehearser, session, request, environment, threads=2)


def foresee(rehearser, session, request, environment, threads=1, tree="pick_and_place"):
    forecaster = RolloutForecaster(rehearser=rehearser, threads=threads)
    service = ForecastService({"rollouts": forecaster}.__getitem__, SystemClock())
    return service.forecast(Case(session=session, request=request, tree=tree, environment=environment))


def draw(rehearser, stage, environment, samples, seed=5):
    spec = read_scene(rehearser.library.get_scene(environment.scene))
    estimate = (stage.physics, stage.start, spec, environment, rehearser.profile)
    return [draw_start(*estimate, seed=seed, number=number) for number in range(samples)]


def copy_start(stage):
    # the world as believed
    model = stage.physics.model
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, stage.start, mujoco.mjtState.mjSTATE_INTEGRATION)
    state = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    return ImaginedStart(model, state)


def test_the_tape_of_a_rehearsal_leads_the_believed_world_to_the_same_end(stage, rehearsal):
    assert rehearsal.outcome.ended is Ended.COMPLETED
    playback = Playback(rehearsal)
    (course,) = playback.play([copy_start(stage)])

    assert "coaster" in {name for held in course.held for name in held}
    assert find_cause(course, course, rehearsal) in {"", "LOAD_LOST"}
    place = course.terminal.entities["coaster"].pose.position_m
    tray = course.terminal.entities["tray"].pose.position_m
    assert np.allclose(place[:2], tray[:2], atol=0.09)
    assert len(playback.nominal.held) == len(course.held)
    assert np.mean([a == b for a, b in zip(playback.nominal.held, course.held, strict=True)]) > 0.9
    rehearsed = playback.nominal.terminal.entities["coaster"].pose.position_m
    assert np.allclose(place, rehearsed, atol=2e-3)


def test_threads_change_nothing(rehearser, stage, rehearsal, environment):
    starts = draw(rehearser, stage, environment, 4)

    one, two = (Playback(rehearsal, threads).play(starts) for threads in (1, 2))

    assert [each.terminal.entities for each in one] == [each.terminal.entities for each in two]


def test_a_world_is_drawn_by_its_number_alone(rehearser, stage, environment):
    few, many = (draw(rehearser, stage, environment, samples) for samples in (2, 4))
    others = draw(rehearser, stage, environment, 2, seed=6)

    for first, second, other in zip(few, many, others, strict=False):
        assert first.state.tobytes() == second.state.tobytes() != other.state.tobytes()
        assert np.array_equal(first.model.body_mass, second.model.body_mass)
        assert np.array_equal(first.model.geom_friction, second.model.geom_friction)


def test_drawn_weights_and_grips_lie_in_the_declared_spans_and_the_mean_is_no_truth(rehearser, stage, environment):
    starts = draw(rehearser, stage, environment, 12)
    coin = stage.physics.model.body("coin").id
    geom = int(stage.physics.model.body_geomadr[coin])

    masses = [start.model.body_mass[coin] for start in starts]
    grips = [start.model.geom_friction[geom, 0] for start in starts]
    assert 0.04 <= min(masses) < max(masses) <= 0.07
    assert 0.04 <= min(grips) < max(grips) <= 0.14
    assert all(start.model.body_subtreemass[coin] == start.model.body_mass[coin] for start in starts)


def test_the_imagined_world_is_the_same_whatever_the_true_one_weighs(library, environment, stage):
    spec = read_scene(library.get_scene(WAITER))
    true = {seed: {each.name: each for each in draw_bodies(spec, seed)}["coin"] for seed in (1, 2)}
    assert true[1].mass_kg != true[2].mass_kg
    assert true[1].grip != true[2].grip

    believed = believe_scene(spec, environment)
    coins = [{each.name: each for each in draw_bodies(believed, seed)}["coin"] for seed in (1, 2)]

    assert coins[0] == coins[1]
    assert (coins[0].mass_kg, coins[0].grip) == pytest.approx((0.055, 0.09))
    stage.reset()
    imagined = stage.observe().entities["coin"].pose.position_m
    assert np.allclose(imagined, environment.entities["coin"].pose.position_m, atol=5e-4)


def test_a_load_that_slips_is_foreseen_and_slowness_is_the_remedy(result):
    assert result.is_low
    assert result.likely_cause == "LOAD_LOST"
    best = result.alternatives[0]
    assert best.strategy.speed < 1.0
    assert best.share >= result.threshold > result.share


def test_what_cannot_be_planned_is_foreseen_with_the_planner_s_code(rehearser, session, environment):
    away = msgspec.structs.replace(
        session, parameters={"object": "coaster", "destination": "coin"}, accept=("inside(coaster, coin)",)
    )
    request = LookaheadRequest(samples=3, threshold=0.5, seed=1)

    foreseen = foresee(rehearser, away, request, environment)

    assert foreseen.succeeded == 0
    assert foreseen.samples == 1, "what cannot be planned needs no rollouts"
    assert foreseen.causes == {"OBJECT_GONE": 1}
    assert foreseen.alternatives == ()
    assert "the rehearsal itself ended skill_failed" in foreseen.notes[-1]


def test_a_policy_has_no_tree_so_rollouts_do_not_foresee_it_and_nothing_starts(rehearser, session, environment):
    with pytest.raises(ExecutionError, match="LOOKAHEAD_FAILED: skill 'pick_and_place' is no tree"):
        foresee(rehearser, session, LookaheadRequest(), environment, tree="")


def test_what_is_tried_whatever_is_foreseen_costs_one_batch(rehearser, session, environment):
    slow = msgspec.structs.replace(session, strategy=Strategy(speed=0.5))
    request = LookaheadRequest(samples=16, threshold=0.0, seed=5)

    foreseen = foresee(rehearser, slow, request, environment)

    assert foreseen.samples == BATCH
    assert foreseen.alternatives == ()


def test_the_head_start_ends_before_anything_is_near_and_then_the_world_goes_on_alike(stage, rehearsal):
    start = copy_start(stage)
    head = SharedPrefix(rehearsal, settle_steps=150)
    assert 0 < head.steps < len(rehearsal.controls) / 2

    data = mujoco.MjData(start.model)
    mujoco.mj_setState(start.model, data, start.state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    for row in rehearsal.controls[: head.steps]:
        data.ctrl[:] = row
        mujoco.mj_step(start.model, data)
    ahead = mujoco.MjData(start.model)
    mujoco.mj_setState(start.model, ahead, head.put(start.state), mujoco.mjtState.mjSTATE_FULLPHYSICS)
    assert np.allclose(ahead.qpos, data.qpos, atol=2e-4)
    assert np.allclose(ahead.qvel, data.qvel, atol=2e-2)


def test_a_drawn_object_lies_where_it_was_drawn_after_the_head_start(rehearser, stage, rehearsal, environment):
    (drawn,) = draw(rehearser, stage, environment, 1)
    coin = int(drawn.model.jnt_qposadr[drawn.model.body("coin").jntadr[0]])
    before, ahead = mujoco.MjData(drawn.model), mujoco.MjData(drawn.model)
    mujoco.mj_setState(drawn.model, before, drawn.state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    put = SharedPrefix(rehearsal, settle_steps=150).put(drawn.state)
    mujoco.mj_setState(drawn.model, ahead, put, mujoco.mjtState.mjSTATE_FULLPHYSICS)

    assert np.array_equal(before.qpos[coin : coin + 7], ahead.qpos[coin : coin + 7])
    assert not np.allclose(
        before.qpos[stage.physics.state.q_address], ahead.qpos[stage.physics.state.q_address], atol=0.01
    )


def test_a_condition_that_must_hold_all_through_is_watched_from_the_beginning(rehearsal):
    watched = msgspec.structs.replace(rehearsal.session, hold=("upright(coaster)",))

    assert SharedPrefix(dataclasses.replace(rehearsal, session=watched), settle_steps=150).steps == 0


def test_a_coin_that_is_seen_on_its_rim_and_within_the_coaster_is_believed_to_lie_on_it(rehearser, environment):
    coin = environment.entities["coin"]
    x, y, z = coin.pose.position_m
    rim = msgspec.structs.replace(coin, pose=Pose((x, y, z - 0.003), (0.70710678, 0.70710678, 0.0, 0.0)))
    seen = msgspec.structs.replace(environment, entities={**environment.entities, "coin": rim})

    believed = rehearser.open_stage(seen).observe().entities["coin"].pose

    assert np.allclose(believed.position_m, coin.pose.position_m, atol=1e-3)
    assert abs(Rotation.from_quat(np.roll(believed.quaternion_wxyz, -1)).apply((0.0, 0.0, 1.0))[2]) > 0.999


def test_what_rests_as_it_was_seen_is_left_as_it_was_seen(stage):
    stage.reset()
    physics = stage.physics
    before = np.array(physics.data.qpos)

    assert stand_up_sunk(physics.model, physics.data, ["coaster", "coin"]) == []
    assert np.array_equal(before, physics.data.qpos)


def test_what_is_seen_beside_an_object_and_a_little_within_it_does_not_climb_it(stage):
    stage.reset()
    physics = stage.physics
    model = physics.model
    coin, coaster = (int(model.jnt_qposadr[model.body(name).jntadr[0]]) for name in ("coin", "coaster"))
    physics.data.qpos[coin : coin + 3] = physics.data.qpos[coaster : coaster + 3] + np.array((0.02, 0.0, -0.011))

    assert stand_up_sunk(model, physics.data, ["coaster", "coin"]) == []


def test_a_gone_object_is_not_imagined(library, environment):
    spec = read_scene(library.get_scene(WAITER))
    without = msgspec.structs.replace(
        environment, entities={name: each for name, each in environment.entities.items() if name != "coin"}
    )

    assert "coin" not in believe_scene(spec, without).bodies


def test_the_model_that_is_drawn_from_is_left_as_it_was(stage, rehearser, environment):
    before = np.array(stage.physics.model.geom_friction)
    draw(rehearser, stage, environment, 2)

    assert np.array_equal(before, stage.physics.model.geom_friction)
    assert mujoco.mj_stateSize(stage.physics.model, mujoco.mjtState.mjSTATE_INTEGRATION) == stage.start.size
