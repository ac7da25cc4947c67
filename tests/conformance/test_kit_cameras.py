"""Cameras of a body that the kit serves: pictures over the wire, and drawn from a compiled MuJoCo model."""

import importlib

import mujoco
import numpy as np
import pytest

from phyagentos.geometry import compute_rotation
from phyagentos.runtime.targets import wire
from tests.served_kit import KIT, Served

EYE = '''
import struct

from slide import Slide, main
from target_server.body import Picture
from target_server.wire import Refusal


class Watched(Slide):
    """A slide, and a camera of three by two pixels, of which each has its own number."""

    cameras = ("eye",)

    def capture(self, cameras, windows, every):
        if {*cameras, *windows} - {"eye"}:
            raise Refusal("REQUEST_INVALID", "there is eye")
        left, top, width, height = windows.get("eye", (0, 0, 3, 2))
        some = [3 * row + column for row in range(top, top + height) for column in range(left, left + width)]
        depth = struct.pack(f"<{len(some)}f", *(0.5 + number for number in some))
        rgb = bytes(channel for number in some for channel in (number, 10, 20))
        place = {"position_m": (0.0, 0.0, self._q), "quaternion_wxyz": (0.0, 1.0, 0.0, 0.0)}
        lens = {"focal_px": (100.0, 100.0), "center_px": (1.5 - left, 1.0 - top)}
        return [Picture("eye", self.time_s, width, height, **lens, **place, rgb=rgb, depth_m=depth)]


main(Watched)
'''


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    """A client of a body with a camera."""
    made = Served(tmp_path_factory.mktemp("watched"), EYE)
    target = made.reach()
    target.exchange(wire.LoadScene("counter", 1, "e"))
    yield target
    target.close()
    made.close()


def test_pictures_arrive_as_they_were_seen_whole_and_in_windows(watched):
    assert watched.exchange(wire.Describe()).depth_cameras == ("eye",)
    (whole,) = watched.exchange(wire.Capture()).frames
    (part,) = watched.exchange(wire.Capture(cameras=("eye",), crops={"eye": (1, 0, 2, 1)})).frames

    assert whole.rgb.tolist()[1][2] == [5, 10, 20]
    assert whole.depth_m.tolist() == [[0.5, 1.5, 2.5], [3.5, 4.5, 5.5]]
    assert part.depth_m.tolist() == [[1.5, 2.5]]
    assert (whole.cx - part.cx, whole.cy - part.cy, part.width, part.height) == (1.0, 0.0, 2, 1)


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (wire.Capture(cameras=("ear",)), "REQUEST_INVALID"),
        (wire.Capture(crops={"eye": (0, 0, 1)}), "MALFORMED"),
        (wire.Capture(cameras=(1,)), "MALFORMED"),
    ],
)
def test_what_is_no_camera_or_no_window_is_refused(watched, request_, code):
    refused = watched.exchange(request_)

    assert isinstance(refused, wire.Refused)
    assert refused.code == code


ROOM = """
<mujoco>
  <worldbody>
    <light pos="0 0 3"/>
    <camera name="above" pos="0 0 1.5" fovy="40"/>
    <geom name="floor" group="1" type="plane" size="2 2 0.1" rgba="0.2 0.2 0.2 1"/>
    <geom name="unseen" group="0" type="box" size="1 1 0.01" pos="0 0 1"/>
    <body name="block" pos="0.1 0.05 0.1"><geom group="1" type="box" size="0.1 0.1 0.1" rgba="0.9 0.1 0.1 1"/></body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def cameras(monkeypatch):
    """The kit's camera above a red block, in a frame whose origin is beside it, and the state of its world."""
    monkeypatch.syspath_prepend(str(KIT))
    drawn = importlib.import_module("target_server.mujoco_cameras")
    model = mujoco.MjModel.from_xml_string(ROOM)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    made = drawn.Cameras(
        model, {"eye": drawn.Sensor("above", 96, 64, (0.1, 1.45))}, np.array((0.1, 0.0, 0.0)), np.eye(3)
    )
    try:
        made.capture(data, 0.0, (), {}, 1)
    except Exception as error:
        pytest.skip(f"this machine draws nothing ({error}): `MUJOCO_GL=osmesa pytest {__file__}`, with OSMesa")
    yield made, data
    made.close()


@pytest.mark.sim
def test_a_drawn_pixel_lies_on_the_surface_that_it_shows_and_beyond_the_range_is_none(cameras):
    made, data = cameras
    (picture,) = made.capture(data, 0.0, ("eye",), {}, 1)
    depth = np.frombuffer(picture.depth_m, "<f4").reshape(64, 96)
    rgb = np.frombuffer(picture.rgb, np.uint8).reshape(64, 96, 3).astype(int)
    red = rgb[..., 0] > 2 * rgb[..., 1]

    assert (np.isnan(depth) == ~red).mean() > 0.99, "the floor is farther than the range"
    red &= np.isfinite(depth)
    rows, columns = np.nonzero(red)
    rays = [
        (each + 0.5 - c) / f for each, c, f in zip((columns, rows), picture.center_px, picture.focal_px, strict=True)
    ]
    points = np.column_stack((*rays, np.ones(len(rows)))) * depth[red][:, None]
    points = points @ compute_rotation(picture.quaternion_wxyz).T + picture.position_m
    assert points[:, 2] == pytest.approx(0.2, abs=1e-4)
    assert points.min(axis=0)[:2] == pytest.approx((-0.1, -0.05), abs=0.02)
    assert points.max(axis=0)[:2] == pytest.approx((0.1, 0.15), abs=0.02)


@pytest.mark.sim
def test_a_window_is_that_part_of_the_whole_and_thinned_has_its_middles(cameras):
    made, data = cameras
    whole, part, thin = (
        np.frombuffer(made.capture(data, 0.0, ("eye",), windows, every)[0].rgb, np.uint8)
        for windows, every in (({}, 1), ({"eye": (40, 20, 30, 21)}, 1), ({"eye": (40, 20, 30, 21)}, 3))
    )
    own = whole.reshape(64, 96, 3)[20:41, 40:70]
    assert np.array_equal(part.reshape(21, 30, 3), own)
    assert np.array_equal(thin.reshape(7, 10, 3), own[1::3, 1::3])


@pytest.mark.sim
def test_the_look_of_an_object_is_its_own_colours_without_those_of_what_stands_around(cameras):
    made, data = cameras
    sides = made.photograph(data, [2], data.xpos[1], 0.18)

    colors = np.array([color for side in sides for color in side])
    assert (colors[:, 0] > 2.0 * colors[:, 1]).all()
    assert [sum(color[3] for color in side) for side in sides] == pytest.approx([1.0] * len(sides), abs=0.05)
