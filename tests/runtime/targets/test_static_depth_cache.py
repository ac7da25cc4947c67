"""Pictures that cost less: what was kept and what is read out in part show what a whole new picture shows."""

from dataclasses import replace

import numpy as np
import pytest

from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.settings.sensors import NoiseLevel, read_sensors
from phyagentos.runtime.drivers.mujoco.ray_cast import RayCaster
from phyagentos.runtime.drivers.mujoco.simulated_camera import open_cameras, pose_state
from phyagentos.runtime.drivers.mujoco.static_depth_cache import MovingSolids, Shot

pytestmark = pytest.mark.sim

SHIPPED = read_sensors(find_shipped_root() / "protocol" / "sensors.yaml")


def capture(physics, data, noise, **options):
    sensors = SHIPPED.model_copy(update={"noise_level": "x", "noise_levels": {"x": noise}})
    return open_cameras(physics.model, sensors, seed=7)["overhead"].capture(
        data, 0.0, np.random.default_rng(1), **options
    )


def pose_many(physics):
    """States of one world: the arm turned, a cube lifted in front of the others, everything as it was."""
    for turn_rad, cube in ((0.4, (0.5, 0.0, 0.3)), (-0.6, (0.45, 0.2, 0.02)), (0.0, None)):
        qpos = np.array(physics.data.qpos)
        qpos[physics.state.q_address] += np.array([turn_rad, 0, 0, 0, 0, 0, 0])
        if cube is not None:
            address = int(physics.model.jnt_qposadr[physics.model.body("red_cube").jntadr[0]])
            qpos[address : address + 3] = cube
        yield pose_state(physics.model, qpos)


def test_a_static_cache_that_was_kept_gives_the_bits_of_a_picture_cast_whole(physics):
    kept, cameras = RayCaster(physics.model), open_cameras(physics.model, SHIPPED, seed=7)
    moving, pixels = MovingSolids(physics.model), {}
    for data in pose_many(physics):
        for name in ("overhead", "left", "right"):
            lens, place = cameras[name].mounting.lens, cameras[name].mounting.find(data)
            whole = RayCaster(physics.model).cast(data, Shot(lens, place, 3.0))
            covered = kept.cast(data, Shot(lens, place, 3.0, still=True))
            for part in ("rgb", "depth_m", "incidence"):
                np.testing.assert_array_equal(getattr(covered, part), getattr(whole, part), strict=True)
            near = moving.find_near(data, lens, place, np.arange(whole.depth_m.size))
            pixels.setdefault(name, set()).add(len(near) / whole.depth_m.size)
    assert all(len(shares) > 1 and max(shares) < 0.4 for shares in pixels.values())


def test_a_window_that_shows_a_static_cache_has_the_bits_of_one_cast_alone(physics):
    kept, camera = RayCaster(physics.model), open_cameras(physics.model, SHIPPED, seed=7)["left"]
    whole, window, corner = camera.mounting.lens, (90, 60, 40, 50), (90, 60)
    rows, columns = np.meshgrid(np.arange(1, 50, 3), np.arange(1, 40, 3), indexing="ij")
    for data in pose_many(physics):
        place = camera.mounting.find(data)
        kept.cast(data, Shot(whole, place, 3.0, still=True))
        for pixels in (None, (rows.ravel(), columns.ravel())):
            shot = Shot(whole.crop(window), place, 3.0, pixels, still=True, whole=whole, corner=corner)
            covered, alone = kept.cast(data, shot), RayCaster(physics.model).cast(data, replace(shot, still=False))
            for part in ("rgb", "depth_m", "incidence"):
                np.testing.assert_array_equal(getattr(covered, part), getattr(alone, part), strict=True)


def test_a_window_that_shows_no_motion_has_the_same_bits_before_and_after_it(physics):
    kept, camera = RayCaster(physics.model), open_cameras(physics.model, SHIPPED, seed=7)["left"]
    whole, before, found = camera.mounting.lens, pose_state(physics.model, np.array(physics.data.qpos)), []
    place = camera.mounting.find(before)
    kept.cast(before, Shot(whole, place, 3.0, still=True))
    for after in pose_many(physics):
        for left in range(0, whole.width - 24, 24):
            for top in range(0, whole.height - 24, 24):
                window = (left, top, 24, 24)
                shot = Shot(whole.crop(window), place, 3.0, still=True, whole=whole, corner=(left, top))
                one, other = kept.cast(after, shot), kept.cast(before, shot)
                is_equal = all(
                    np.array_equal(getattr(one, part), getattr(other, part)) for part in ("rgb", "depth_m", "incidence")
                )
                found.append((kept.shows_motion(after, before, shot), is_equal))
    assert set(found) >= {(True, False), (False, True)}
    assert (False, False) not in found


def test_a_camera_that_moves_may_always_show_motion(physics):
    camera = open_cameras(physics.model, SHIPPED, seed=7)["wrist"]
    before, after = pose_state(physics.model, np.array(physics.data.qpos)), next(pose_many(physics))
    shot = Shot(camera.mounting.lens, camera.mounting.find(after), 3.0)
    assert RayCaster(physics.model).shows_motion(after, before, shot)


def test_a_static_cache_is_cast_anew_when_something_fixed_was_moved(physics):
    data = pose_state(physics.model, physics.data.qpos)
    camera, kept = open_cameras(physics.model, SHIPPED, seed=7)["overhead"], RayCaster(physics.model)
    shot = Shot(camera.mounting.lens, camera.mounting.find(data), 3.0, still=True)
    before = kept.cast(data, shot)
    data.geom_xpos[physics.model.body("red_tray").geomadr[0]] += (0.1, 0.0, 0.05)
    after = kept.cast(data, shot)
    whole = RayCaster(physics.model).cast(data, replace(shot, still=False))
    np.testing.assert_array_equal(after.depth_m, whole.depth_m)
    assert (before.depth_m != after.depth_m).any()


def test_a_thinned_picture_shows_what_the_whole_one_shows_in_the_middle_of_its_squares(physics, data):
    whole = capture(physics, data, NoiseLevel(), crop=(20, 10, 24, 17))
    thinned = capture(physics, data, NoiseLevel(), crop=(20, 10, 24, 17), every=3)

    assert (thinned.width, thinned.height) == (8, 5)
    assert (3 * thinned.fx, 3 * thinned.cx, 3 * thinned.cy) == pytest.approx((whole.fx, whole.cx, whole.cy))
    np.testing.assert_array_equal(thinned.rgb, whole.rgb[1:16:3, 1::3])
    np.testing.assert_allclose(thinned.depth_m, whole.depth_m[1:16:3, 1::3], atol=1e-6)


def test_the_edges_of_a_thinned_picture_waver_as_those_of_the_whole_one(physics, data):
    wavering = NoiseLevel(lateral_std_rad=0.005)
    clean = capture(physics, data, NoiseLevel()).depth_m
    moved = {
        every: (
            capture(physics, data, wavering, every=every).depth_m != clean[every // 2 :: every, every // 2 :: every]
        )
        for every in (1, 3)
    }
    assert moved[3].shape == (48, 64)
    assert moved[3].mean() == pytest.approx(moved[1].mean(), abs=0.1)
    assert moved[3].mean() > 0.1
