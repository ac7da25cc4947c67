"""The simulated target: who may command it, what it refuses, and that looking changes nothing."""

import json

import numpy as np
import pytest

from phyagentos.runtime.targets import wire

pytestmark = pytest.mark.sim

HOME = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])


def test_the_arm_stands_at_home_without_contact_and_holds_its_posture(rig):
    step = rig.hold(0.08, 0.5)
    assert np.abs(np.array(step.target.q_rad) - HOME).max() < 1e-3
    assert (step.target.holding, step.target.grip_force_n) == ((), 0.0)


@pytest.mark.parametrize(("start_rad", "code"), [(HOME, ""), (HOME + 0.01, ""), (HOME + 0.005, "TARGET_LIMIT")])
def test_an_arm_that_is_pressed_aside_may_begin_where_it_stands(rig, start_rad, code):
    rig.world.driver.controller.hold(HOME + 0.01)
    rows = start_rad + np.zeros((10, 1))
    assert getattr(rig.world.driver.controller.check(rig.make_command(HOME, q_rad=rows)), "code", "") == code


def test_an_unknown_scene_is_refused_with_the_nearest_name(make_rig):
    reply = make_rig().load(scene="tabletop/cubes_and_tray")
    assert reply.code == "UNKNOWN_NAME"
    assert "Did you mean 'tabletop/cubes_and_trays'?" in reply.message


def test_a_picture_that_is_begun_is_of_that_moment_and_fetched_once(rig):
    rig.load()
    rig.begin()
    drawn = rig.world.handle(render("overview", 160, 120))
    if not drawn.artefacts:
        pytest.skip(f"no graphics here: {drawn.reason}")
    ahead = wire.InvokeTool(wire.RENDER_AHEAD, {"camera": "overview", "width": 160, "height": 120, "name": "x.png"})
    rig.world.handle(ahead)
    rig.send(rig.make_command(HOME, 0.0))
    fetched, again = (rig.world.handle(wire.InvokeTool(wire.PICTURES, {"wait": True})).artefacts for _ in range(2))

    assert fetched == {"x.png": drawn.artefacts["picture.png"]}
    assert again == {}


def render(camera, width, height):
    return wire.InvokeTool(wire.RENDER, {"camera": camera, "width": width, "height": height})


def test_a_restored_world_goes_on_bit_for_bit(make_rig):
    rig = make_rig()
    rig.load()
    rig.begin()
    rig.grasp("red_cube")
    middle = rig.observe().snapshot.data
    rig.world.handle(wire.End(session="s", epoch=1))
    rig.begin("t")
    motion = rig.plan(rig.driver.controller.q_rad + 0.03, 0.6)
    for q, qd in motion:
        assert isinstance(rig.send(rig.make_command(q, 0.0, qd)), wire.Step)
    first = rig.observe().snapshot.data

    other = make_rig()
    other.load(snapshot=middle)
    other.begin("t")
    for q, qd in motion:
        assert isinstance(other.send(other.make_command(q, 0.0, qd)), wire.Step)
    assert other.observe().snapshot.data == first


def test_a_halt_decelerates_and_holds(rig):
    goal = rig.reach((0.55, 0.1, 0.3))
    for q, qd in rig.plan(goal, 1.0)[:25]:
        assert isinstance(rig.send(rig.make_command(q, qd=qd)), wire.Step)
    assert np.abs(rig.observe().target.qd_rad_s).max() > 0.1
    step = rig.world.handle(wire.Halt(session="s", epoch=1))
    assert np.abs(step.target.qd_rad_s).max() < 0.02
    later = rig.world.handle(wire.Settle(session="s", epoch=1, duration_s=0.3))
    assert np.abs(np.array(later.target.q_rad) - step.target.q_rad).max() < 0.005


def test_a_simulation_that_diverges_is_told_and_does_not_begin_anew(rig):
    physics = rig.world.driver.physics
    physics.data.qvel[physics.model.body("red_cube").dofadr[0]] = np.nan
    assert rig.world.handle(rig.make_command(HOME)).code == "TARGET_LOST"
    assert rig.world.handle(wire.Observe()).code == "TARGET_LOST"


def test_a_grasp_is_seen_by_both_pads(rig):
    step = rig.grasp("red_cube")
    assert step.target.holding == ("red_cube",)
    assert rig.entity("red_cube").held_by == "panda"
    assert rig.entity("red_cube").pose.position_m[2] > 0.15
    assert rig.entity("green_cube").held_by is None


def test_the_receive_log_tells_every_request_that_could_move_and_every_state_write(make_rig, tmp_path):
    rig = make_rig(log=tmp_path / "log.jsonl")
    rig.load()
    rig.begin()
    rig.hold(0.08, 0.1)
    rig.world.handle(rig.make_command(HOME, epoch=7))
    rig.world.handle(wire.End(session="s", epoch=1))
    rig.world.close()
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    kinds = [line["kind"] for line in lines]
    assert kinds == ["process_start", "state_write", "LoadScene", "Begin", *["Command"] * 6, "End"]
    assert [line.get("accepted", True) for line in lines if line["kind"] == "Command"] == [True] * 5 + [False]
    assert lines[-2]["code"] == "STALE_TOKEN"


def test_a_picture_is_a_png_or_a_reason(rig):
    assert "overview" in rig.world.handle(wire.Describe()).cameras
    result = rig.world.handle(render("overview", 160, 120))
    assert result.reason or result.artefacts["picture.png"].data.startswith(b"\x89PNG")
    assert "no camera 'nowhere'" in rig.world.handle(render("nowhere", 160, 120)).reason


def test_the_fingers_move_as_fast_as_their_drive_and_no_faster(rig):
    rig.hold(0.08, 0.1)
    home = rig.driver.controller.q_rad
    widths = [rig.send(rig.make_command(home, 0.0)).target.gripper_width_m for _ in range(30)]
    fastest_m = rig.profile.gripper.speed_m_s * rig.profile.control_period_s
    assert max(np.abs(np.diff(widths))) == pytest.approx(fastest_m, rel=0.1)


def test_fingers_that_close_on_air_press_on_nothing(rig):
    closed = rig.hold(0.0, 1.5).target
    assert not closed.is_gripping
