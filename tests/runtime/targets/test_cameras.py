"""What simulated cameras tell: true geometry, the noise that is declared, the past, and the lies of a fault file."""

import math
from copy import copy

import mujoco
import numpy as np
import pytest

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.settings.sensors import CameraSettings, NoiseLevel, Sensor, Sensors, read_sensors
from phyagentos.protocol.world.faults import FaultFile
from phyagentos.runtime.drivers.mujoco.joint_controller import StateHistory
from phyagentos.runtime.drivers.mujoco.rendering import GraphicsCaster, render_png
from phyagentos.runtime.drivers.mujoco.simulated_camera import SimulatedCamera, open_cameras, pose_state
from phyagentos.runtime.drivers.mujoco.static_depth_cache import VISIBLE_GROUPS
from phyagentos.runtime.models.camera_model import Lens, look_at
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.wire import REPLIES

pytestmark = pytest.mark.sim

SHIPPED = read_sensors(find_shipped_root() / "protocol" / "sensors.yaml")
ABOVE = {"position_m": (0.5, 0.0, 1.2), "target_m": (0.5, 0.0, 0.0), "up": (1.0, 0.0, 0.0), "fovy_deg": 45}
SMALL = {"width": 64, "height": 48}


CLEAN = NoiseLevel()


def make_sensors(noise=CLEAN, rate_hz=25.0, synchronised=True, **cameras) -> Sensors:
    chosen = cameras or {"above": {**ABOVE, **SMALL}}
    sensors = {
        name: Sensor(modality="rgbd", rate_hz=rate_hz, provides=("camera_rgb",), camera=CameraSettings(**camera))
        for name, camera in chosen.items()
    }
    return Sensors(sensors=sensors, noise_level="x", noise_levels={"x": noise}, synchronised=synchronised)


def capture(physics, data, sensors, name="above", **options):
    camera = open_cameras(physics.model, sensors, seed=7)[name]
    return camera.capture(data, 0.0, np.random.default_rng(1), **options)


def project(frame, point):
    """Pixel (u, v) and depth of a point in the world."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, np.array(frame.world_T_camera.quaternion_wxyz))
    x, y, z = rotation.reshape(3, 3).T @ (np.asarray(point) - frame.world_T_camera.position_m)
    return frame.fx * x / z + frame.cx, frame.fy * y / z + frame.cy, z


@pytest.mark.parametrize("name", ["overhead", "left", "right"])
def test_the_top_of_a_cube_is_seen_where_geometry_says(physics, data, name):
    frame = capture(physics, data, SHIPPED.model_copy(update={"noise_level": "none"}), name)
    cube = physics.queries.find_position("red_cube")
    u, v, depth = project(frame, np.add(cube, (0.0, 0.0, 0.02)))

    seen = frame.depth_m[int(v), int(u)]
    red, green, blue = frame.rgb[int(v), int(u)].tolist()
    assert abs(seen - depth) < depth / frame.fy  # one pixel
    assert red > 2 * green
    assert red > 2 * blue


def test_every_depth_is_the_distance_of_the_plane_that_the_ray_meets():
    lens = Lens(60.0, 60.0, 32.0, 24.0, 64, 48)
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom type='plane' size='9 9 1' pos='0 0 0'/></worldbody></mujoco>"
    )
    settings = CameraSettings(position_m=(0, 0, 2), target_m=(1, 0, 0), fx=60, fy=60, cx=32, cy=24, **SMALL)
    sensors = make_sensors(eye=settings.model_dump())
    frame = open_cameras(model, sensors, seed=0)["eye"].capture(
        pose_state(model, np.zeros(0)), 0.0, np.random.default_rng(0)
    )

    viewpoint = look_at(np.array([0, 0, 2.0]), np.array([1.0, 0, 0]), np.array([0, 0, 1.0]))
    points = viewpoint.position_m + frame.depth_m.reshape(-1, 1) * (lens.compute_rays() @ viewpoint.rotation.T)
    assert (frame.fx, frame.fy, frame.cx, frame.cy) == (60, 60, 32, 24)
    assert np.nanmax(np.abs(points[:, 2])) < 1e-5
    assert np.isfinite(frame.depth_m).mean() > 0.5


def draw(physics, data):
    """The drawn frame, or the code of why there is none."""
    left = SHIPPED.sensors["left"].camera
    drawing = SimulatedCamera(physics.model, "left", left, NoiseLevel(), GraphicsCaster(physics.model), 7)
    try:
        return drawing.capture(data, 0.0, np.random.default_rng(1)), ""
    except ExecutionError as error:
        return None, error.code


def test_both_back_ends_measure_the_same_depth_or_say_that_there_are_no_graphics(physics, data):
    sensors = SHIPPED.model_copy(update={"noise_level": "none"})
    cast = capture(physics, data, sensors, "left")
    drawn, code = draw(physics, data)
    if drawn is None:
        assert code == "NO_GRAPHICS"
        return
    both = np.isfinite(cast.depth_m) & np.isfinite(drawn.depth_m)
    assert both.mean() > 0.95 * np.isfinite(cast.depth_m).mean()
    assert np.percentile(np.abs(cast.depth_m - drawn.depth_m)[both], 99) < 1e-3
    assert np.median(np.abs(cast.rgb.astype(int) - drawn.rgb)) < 40  # neither shadows nor gloss are cast


def test_a_machine_without_graphics_gives_no_frame_and_a_code(physics, monkeypatch, make_rig):
    def refuse(*_):
        raise RuntimeError("no display")

    monkeypatch.setattr(mujoco, "Renderer", refuse)
    rig = make_rig(sensors=make_sensors().model_copy(update={"backend": "render"}))
    rig.load()
    assert rig.world.handle(wire.Capture()) == wire.Frames((), {"above": "NO_GRAPHICS"})


def test_a_picture_for_people_leaves_the_model_as_it_was(physics, data):
    name = physics.model.camera(0).name
    assert render_png(physics.model, data, name, 64, 48) == render_png(physics.model, data, name, 64, 48)
    assert physics.model.vis.quality.shadowsize == 4096  # what evidence records of the model


def test_graphics_that_failed_are_opened_anew_for_the_next_picture(physics, data, monkeypatch):
    name = physics.model.camera(0).name
    before = render_png(physics.model, data, name, 64, 48)
    with monkeypatch.context() as broken:
        broken.setattr(mujoco.Renderer, "render", lambda _: 1 / 0)
        assert "ZeroDivisionError" in render_png(physics.model, move(physics.model, data), name, 64, 48).reason
    opened = []
    monkeypatch.setattr(mujoco.Renderer, "__init__", count_calls(mujoco.Renderer.__init__, opened))
    assert [render_png(physics.model, data, name, 64, 48) for _ in range(2)] == [before, before]
    assert len(opened) == (1 if before.artefacts else 2)


def move(model, data):
    moved = copy(data)
    moved.qpos[0] += 0.1
    mujoco.mj_forward(model, moved)
    return moved


def test_the_same_world_is_drawn_once_and_another_anew(physics, data, monkeypatch):
    name, drawn = physics.model.camera(0).name, []
    first, again = (render_png(physics.model, data, name, 64, 48) for _ in range(2))
    monkeypatch.setattr(mujoco.Renderer, "render", count_calls(mujoco.Renderer.render, drawn))
    other = render_png(physics.model, move(physics.model, data), name, 64, 48)
    back = render_png(physics.model, data, name, 64, 48)
    assert first == again == back
    if first.artefacts:
        assert other != first
        assert len(drawn) == 2


def count_calls(function, calls):
    def counted(*given, **named):
        calls.append(function)
        return function(*given, **named)

    return counted


def test_the_arm_hides_what_is_behind_it(physics, data):
    q = np.array(physics.data.qpos)
    frame = capture(physics, data, make_sensors(), "above")
    tcp, _ = physics.queries.find_tcp()
    u, v, depth = project(frame, tcp)

    assert frame.depth_m[int(v), int(u)] < depth - 0.02  # the hand is above its own fingertips
    assert (np.array(physics.data.qpos) == q).all()


def test_the_wrist_camera_sees_past_the_fingers_and_moves_with_the_hand(physics, data):
    camera = open_cameras(physics.model, SHIPPED, seed=7, level="none")["wrist"]
    frame = camera.capture(data, 0.0, np.random.default_rng(1))
    rotated = np.array(physics.data.qpos)
    rotated[physics.state.q_address] += [0.5, 0, 0, 0, 0, 0, 0]
    turned = camera.capture(pose_state(physics.model, rotated), 0.0, np.random.default_rng(1))

    rays = camera.mounting.lens.compute_rays()
    assert np.isfinite(frame.depth_m).mean() > 0.9
    assert (frame.depth_m > 0.3).mean() > 0.6  # not the inside of its own hand
    assert math.dist(frame.world_T_camera.position_m, turned.world_T_camera.position_m) > 0.15
    assert len(rays) == frame.width * frame.height


def test_a_window_shows_what_the_whole_picture_shows_there(physics, data):
    whole = capture(physics, data, make_sensors())
    part = capture(physics, data, make_sensors(), crop=(20, 10, 24, 16))

    assert (part.width, part.height, part.cx, part.cy) == (24, 16, whole.cx - 20, whole.cy - 10)
    np.testing.assert_array_equal(part.rgb, whole.rgb[10:26, 20:44])
    np.testing.assert_allclose(part.depth_m, whole.depth_m[10:26, 20:44], atol=1e-6)


def test_depth_noise_is_as_large_as_the_settings_say(physics, data):
    clean = capture(physics, data, make_sensors())
    level = NoiseLevel(depth_constant_m=0.001, depth_quadratic_per_m=0.01, depth_offset_m=0.2)
    noisy = capture(physics, data, make_sensors(level))

    std = 0.001 + 0.01 * (clean.depth_m - 0.2) ** 2
    normal = (noisy.depth_m - clean.depth_m) / std
    assert 0.9 < np.nanstd(normal) < 1.1
    assert abs(np.nanmean(normal)) < 0.1


def test_pixels_are_lost_and_colours_waver_as_often_as_the_settings_say(physics, data):
    clean = capture(physics, data, make_sensors())
    noisy = capture(physics, data, make_sensors(NoiseLevel(pixel_dropout=0.2, color_std=5.0)))

    lost = np.isnan(noisy.depth_m) & np.isfinite(clean.depth_m)
    middling = (clean.rgb > 30) & (clean.rgb < 225)
    assert 0.17 < lost.mean() < 0.23
    assert 4.0 < (noisy.rgb.astype(float) - clean.rgb)[middling].std() < 6.0


def test_a_calibration_error_is_drawn_once_and_moves_the_picture_not_the_claim(physics, data):
    sensors = make_sensors(NoiseLevel(calibration_position_m=0.02))
    clean, off = capture(physics, data, make_sensors()), capture(physics, data, sensors)

    assert off.world_T_camera == clean.world_T_camera
    assert np.nanmedian(np.abs(off.depth_m - clean.depth_m)) > 0.001
    np.testing.assert_array_equal(off.depth_m, capture(physics, data, sensors).depth_m)


def test_a_frame_travels_over_the_wire_as_it_is(physics, data):
    frame = capture(physics, data, make_sensors(NoiseLevel(pixel_dropout=0.1)))
    arrived = REPLIES.decode(REPLIES.encode(wire.Frames((frame,), {"b": "OBSERVATION_UNAVAILABLE"})))

    assert isinstance(arrived, wire.Frames)
    assert arrived.missing == {"b": "OBSERVATION_UNAVAILABLE"}
    assert (arrived.frames[0].rgb.dtype, arrived.frames[0].depth_m.dtype) == (np.uint8, np.float32)
    np.testing.assert_array_equal(arrived.frames[0].rgb, frame.rgb)
    np.testing.assert_array_equal(arrived.frames[0].depth_m, frame.depth_m)


@pytest.fixture
def look(make_rig):
    """Begins a session in a world with cameras, with one fault or none; looks."""

    def begin(sensors, **fault):
        schedule = FaultFile.model_validate({"version": 1, "faults": [fault] if fault else []})
        rig = make_rig(sensors=sensors, schedule=schedule)
        assert isinstance(rig.load(), wire.Loaded)
        rig.begin()
        return rig

    return begin


def see(rig, **request):
    frames = rig.world.handle(wire.Capture(**request))
    assert isinstance(frames, wire.Frames), frames
    return frames.frames[0]


def turn_away(rig):
    first, *others = rig.profile.arm.home_rad
    rig.move([first + 0.6, *others], seconds=0.6)


def test_looking_changes_no_bit_of_the_simulation_and_the_same_run_sees_the_same_bits(look):
    sensors = SHIPPED.model_copy(update={"noise_level": "harsh"})
    blind, first, second = look(sensors), look(sensors), look(sensors)
    frames = []
    for rig in (blind, first, second):
        for _ in range(3):
            rig.hold(0.08, 0.1)
            if rig is not blind:
                frames.append(see(rig, cameras=("wrist",)))
            if rig is first:
                rig.world.handle(wire.InvokeTool(wire.RENDER, {"camera": "overview", "width": 64, "height": 48}))
                rig.observe()
    assert blind.observe().snapshot == first.observe().snapshot
    for one, other in zip(frames[:3], frames[3:], strict=True):
        np.testing.assert_array_equal(one.depth_m, other.depth_m)
        np.testing.assert_array_equal(one.rgb, other.rgb)
    assert (frames[0].rgb != frames[1].rgb).any()


def test_a_session_that_is_repeated_from_its_first_state_sees_the_same_bits(look):
    sensors = make_sensors(NoiseLevel(color_std=5.0), above={**ABOVE, **SMALL, "latency_s": 0.1})
    first, again = look(sensors), look(sensors)
    first.hold(0.08, 0.3)
    first.world.handle(wire.End(session="s", epoch=1))
    snapshot = first.observe().snapshot.data
    first.begin("t", 2)
    again.world.handle(wire.End(session="s", epoch=1))
    assert isinstance(again.load(snapshot=snapshot, episode="e"), wire.Loaded)
    again.begin("t", 2)

    one, other = see(first), see(again)
    assert one.time_s == other.time_s == first.world.time_s
    np.testing.assert_array_equal(one.rgb, other.rgb)


def test_a_frame_shows_a_past_as_old_as_the_latency(look):
    rig = look(make_sensors(rate_hz=50.0, above={**ABOVE, **SMALL, "latency_s": 0.2}))
    rig.hold(0.08, 0.4)

    assert see(rig).time_s == pytest.approx(rig.world.time_s - 0.2, abs=1e-9)


def test_synchronised_cameras_show_one_moment_and_others_their_own(look):
    cameras = {
        "one": {**ABOVE, **SMALL, "latency_s": 0.1},
        "two": {**ABOVE, **SMALL, "phase_s": 0.02},
    }
    for synchronised, moments in ((True, 1), (False, 2)):
        rig = look(make_sensors(synchronised=synchronised, **cameras))
        rig.hold(0.08, 0.3)
        frames = rig.world.handle(wire.Capture()).frames
        assert len({frame.time_s for frame in frames}) == moments


def test_a_lost_frame_leaves_the_one_before_it(look):
    rig = look(make_sensors(NoiseLevel(frame_dropout=0.6), rate_hz=50.0))
    ages = []
    for _ in range(30):
        rig.hold(0.08, 0.02)
        ages.append(round((rig.world.time_s - see(rig).time_s) / 0.02))

    assert ages.count(0) < 25
    assert max(ages) >= 2


@pytest.mark.parametrize("stamp", ["fresh", "stale", ""])
def test_a_frozen_camera_repeats_its_last_frame_and_another_one_sees_the_arm_move(look, stamp):
    fault = {"kind": "freeze", "camera": "above", "stamp": stamp} if stamp else {}
    rig = look(make_sensors(NoiseLevel(color_std=5.0) if stamp else CLEAN), **fault)
    rig.hold(0.08, 0.1)
    before = see(rig)
    turn_away(rig)
    after = see(rig)

    changed = (after.rgb != before.rgb).mean()
    assert changed == 0.0 if stamp else changed > 0.02
    assert (after.time_s == before.time_s) == (stamp == "stale")


def test_a_dark_camera_gives_black_and_a_silent_one_nothing(look):
    dark = look(make_sensors(), kind="blackout")
    dark.hold(0.08, 0.1)
    silent = look(make_sensors(), kind="blackout", mode="silent")
    silent.hold(0.08, 0.1)

    assert not see(dark).rgb.any()
    assert np.isnan(see(dark).depth_m).all()
    assert silent.world.handle(wire.Capture()) == wire.Frames((), {"above": "OBSERVATION_UNAVAILABLE"})


def test_a_misdated_frame_is_fresh_and_seems_old(look):
    rig = look(make_sensors(), kind="misdate", by_s=-3.0, when={"time_s": 0.6})
    rig.hold(0.08, 0.1)
    honest = see(rig).time_s
    rig.hold(0.08, 0.4)

    assert honest > 0.0
    assert see(rig).time_s < rig.world.time_s - 2.9


def test_a_miscalibrated_camera_tells_a_place_where_it_is_not(look):
    rig = look(make_sensors(), kind="miscalibrate", by_m=[0.05, 0.0, 0.0], duration_s=0.2)
    honest = see(rig)
    rig.hold(0.08, 0.1)
    lying = see(rig)
    rig.hold(0.08, 0.3)

    assert math.dist(lying.world_T_camera.position_m, honest.world_T_camera.position_m) == pytest.approx(0.05)
    assert np.mean(np.abs(lying.depth_m - honest.depth_m) > 0.01) < 0.005  # the arm rests a little otherwise
    assert see(rig).world_T_camera == honest.world_T_camera  # it is over


def test_a_camera_fault_strikes_again_from_its_own_record(look, make_rig):
    from phyagentos.runtime.drivers.mujoco.faults import read_activations

    rig = look(make_sensors(), kind="freeze", when={"time_s": 0.5})
    rig.hold(0.08, 0.3)
    frozen = see(rig)
    struck = rig.world.handle(wire.End(session="s", epoch=1)).faults
    again = make_rig(sensors=make_sensors(), schedule=read_activations(struck))
    again.load()
    again.begin()
    turn_away(again)

    assert [fault.kind for fault in struck] == ["freeze"]
    np.testing.assert_array_equal(see(again).rgb, frozen.rgb)


@pytest.mark.parametrize(
    "request_",
    [
        {"cameras": ("nobody",)},
        {"crops": {"nobody": (0, 0, 4, 4)}},
        {"crops": {"above": (60, 0, 10, 10)}},
        {"crops": {"above": (0, 0, 0, 4)}},
        {"every": 2},
        {"crops": {"above": (0, 0, 4, 4)}, "every": 5},
    ],
)
def test_a_look_that_cannot_be_is_refused(look, request_):
    assert look(make_sensors()).world.handle(wire.Capture(**request_)).code == "REQUEST_INVALID"


def test_a_world_says_which_cameras_can_be_asked(look):
    cameras = {"above": {**ABOVE, **SMALL}, "tail": {**ABOVE, **SMALL, "mount": "tail"}}
    rig = look(make_sensors(**cameras))

    assert rig.world.handle(wire.Describe()).depth_cameras == ("above",)


def test_collision_solids_are_not_seen(physics):
    hidden = [geom for geom in range(physics.model.ngeom) if not VISIBLE_GROUPS[physics.model.geom_group[geom]]]

    assert {int(physics.model.geom_group[geom]) for geom in hidden} == {3}


@pytest.mark.parametrize(("lever", "look"), [("glass_dropout", "glass"), ("black_dropout", "ink")])
def test_glass_and_black_surfaces_lose_depth_and_others_keep_it(lever, look):
    model, data = make_pair(look)
    frame = capture_alone(model, data, make_sensors(NoiseLevel(**{lever: 0.5})))
    lost = np.isnan(frame.depth_m)

    assert 0.3 < lost[:, :24].mean() < 0.7
    assert not lost[:, 40:].any()


def test_what_moves_in_an_exposure_is_blurred_and_loses_its_edges():
    model, data = make_pair("ink")
    before = pose_state(model, data.qpos + np.eye(7)[1] * 0.1, mujoco.MjData(model))
    sharp, moved = (capture_alone(model, data, make_sensors(), begin=begin) for begin in (None, before))

    mixed = np.isnan(moved.depth_m)
    assert mixed.any()
    assert not np.isnan(sharp.depth_m).any()
    assert (moved.rgb[mixed].astype(int) != sharp.rgb[mixed]).any()
    assert np.array_equal(moved.rgb[:, -8:], sharp.rgb[:, -8:])


@pytest.mark.parametrize("every", [1, 3])
def test_an_exposure_in_which_nothing_moved_is_sharp(every):
    model, data = make_pair("ink")
    sharp, still = (capture_alone(model, data, make_sensors(), begin=begin, every=every) for begin in (None, data))

    assert np.array_equal(sharp.rgb, still.rgb)
    assert np.array_equal(sharp.depth_m, still.depth_m)


def test_positions_within_an_exposure_lie_between_those_that_are_kept():
    history = StateHistory()
    for time_s, x in ((0.0, 0.0), (0.02, 1.0), (0.04, 1.0)):
        history.note(time_s, np.array([x]))

    found = [float(history.interpolate(time_s)[0]) for time_s in (-1.0, 0.01, 0.03, 0.05)]
    assert found == pytest.approx([0.0, 0.5, 1.0, 1.0])


def make_pair(look):
    """A box of a look that moves, on a grey floor that it covers half of, and their state."""
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco><asset><material name="glass" rgba="0.3 0.5 0.4 1" specular="0.9" shininess="0.9"/>
      <material name="ink" rgba="0.02 0.02 0.02 1"/></asset>
    <worldbody><light pos="0 0 3"/><geom type="box" size="3 3 .01" pos="0 0 -.01" rgba=".5 .5 .5 1"/>
      <body pos="0.5 0.5 0.1"><freejoint/><geom type="box" size="1 .5 .1" material="{look}"/></body>
    </worldbody></mujoco>""")
    return model, pose_state(model, model.qpos0)


def capture_alone(model, data, sensors, **options):
    camera = open_cameras(model, sensors, seed=7)["above"]
    return camera.capture(data, 0.0, np.random.default_rng(1), **options)
