"""Pictures over ROS 2: the pixels, lenses and places of the project's own cameras."""

import numpy as np
import pytest

from phyagentos.geometry import compute_rotation
from phyagentos.runtime.targets import wire
from phyagentos.testing import DriverSubject
from tests.extras.ros2.cell import CAMERAS, OTHER_HABITS, OTHER_VIEWS, SCENE
from tests.following import wait_until

pytestmark = pytest.mark.extras


@pytest.fixture(params=[{}, {"views": OTHER_VIEWS, "habits": OTHER_HABITS}], ids=["usual", "other habits"])
def seen(request, make_cell):
    """A cell with four cameras, and a client that has frames of all."""
    cell = make_cell(cameras=CAMERAS, **request.param)
    client = DriverSubject(open=cell.reach, scene=SCENE, noise=0.01, set_stop=lambda _: None).serve().begin()
    wait_until(lambda: len(client.ask(wire.Capture()).frames) == len(CAMERAS), "frames of all cameras", 60.0)
    return cell, client


def find_points(frame):
    """(h, w, 3) of each pixel, where in the world it is."""
    rows, columns = np.indices(frame.depth_m.shape) + 0.5
    rays = np.stack(((columns - frame.cx) / frame.fx, (rows - frame.cy) / frame.fy, np.ones_like(rows)), axis=-1)
    turn = compute_rotation(frame.world_T_camera.quaternion_wxyz)
    return (rays * frame.depth_m[..., None]) @ turn.T + frame.world_T_camera.position_m


def test_every_camera_sees_the_red_cube_where_it_is(seen):
    cell, client = seen
    cube = np.array(cell.robot.ask("truth")["bodies"]["red_cube"])
    found = {}
    for frame in client.ask(wire.Capture()).frames:
        assert (frame.height, frame.width) == (480, 640)
        red = (frame.rgb[..., 0] > 90) & (frame.rgb[..., 0] > 2.2 * frame.rgb[..., 1])
        points = find_points(frame)[red & np.isfinite(frame.depth_m)]
        near = points[np.abs(points - cube).max(axis=1) < 0.04]
        found[frame.camera] = len(near)
        if len(near) > 100:
            assert np.median(np.abs(near - cube).max(axis=1)) == pytest.approx(0.02, abs=0.004), frame.camera
    assert min(found[name] for name in CAMERAS[:3]) > 100, found


def test_a_camera_on_the_tool_moves_with_it_and_a_window_is_a_part(seen):
    _cell, client = seen
    frames = {each.camera: each for each in client.ask(wire.Capture()).frames}
    tcp = client.ask(wire.Observe()).target.tcp.position_m
    assert 0.05 < np.linalg.norm(np.subtract(frames["wrist"].world_T_camera.position_m, tcp)) < 0.2
    (part,) = client.ask(wire.Capture(cameras=("overhead",), crops={"overhead": (300, 200, 90, 60)}, every=3)).frames
    whole = frames["overhead"]
    assert (part.width, part.height) == (30, 20)
    assert part.fx == pytest.approx(whole.fx / 3)
    middle = find_points(part)[10, 15]
    assert np.nanmin(np.linalg.norm(find_points(whole)[200:260, 300:390] - middle, axis=-1)) < 0.01


def test_frames_have_the_moments_of_their_exposures_and_no_count_that_ros_has_not(seen):
    _cell, client = seen
    assert not client.ask(wire.Describe()).counts_frames
    before, now = client.ask(wire.Capture()).frames, client.ask(wire.Observe())
    moments_s = {each.camera: each.time_s for each in before}
    shown = lambda: client.ask(wire.Capture()).frames  # noqa: E731
    wait_until(lambda: all(each.time_s > moments_s[each.camera] for each in shown()), "later frames of all", 60.0)
    after = shown()
    assert all(each.number < 0 for each in (*before, *after))
    assert all(now.time_s - 2.0 < each.time_s <= now.time_s + 0.02 for each in before)
    assert all(late.time_s > early.time_s for early, late in zip(before, after, strict=True))
    assert any((late.rgb != early.rgb).any() for early, late in zip(before, after, strict=True)), "noise shows life"
