"""sensors.yaml: cameras as settings, each number within its bounds, each name known."""

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.settings.sensors import CameraSettings, NoiseLevel, read_sensors

SHIPPED = find_shipped_root() / "protocol" / "sensors.yaml"
CAMERA = "position_m: [0, 0, 1], target_m: [0.1, 0, 0], fovy_deg: 40"
FILE = """version: 1
{more}
sensors:
  eye:
    modality: {modality}
    rate_hz: 25
    provides: [camera_rgb]
    {camera}
"""


def read(tmp_path, camera=CAMERA, modality="rgbd", more=""):
    path = tmp_path / "sensors.yaml"
    line = f"camera: {{{camera}}}" if camera else ""
    path.write_text(FILE.format(camera=line, modality=modality, more=more), encoding="utf-8")
    return read_sensors(path)


def test_the_shipped_file_has_cameras_all_around_and_on_the_hand():
    sensors = read_sensors(SHIPPED)

    mounts = [sensor.camera.mount for sensor in sensors.cameras.values()]
    assert mounts.count("world") >= 3
    assert mounts.count("hand") == 1
    assert {"none", "nominal", "harsh"} <= set(sensors.noise_levels)
    assert sensors.noise_level == "nominal"


def test_each_shipped_noise_level_is_at_least_as_bad_as_the_one_before():
    sensors = read_sensors(SHIPPED)
    none, nominal, harsh = (sensors.get_noise(name) for name in ("none", "nominal", "harsh"))

    assert none == NoiseLevel()
    for field in NoiseLevel.model_fields:
        if field != "depth_offset_m":  # where the parabola has its lowest point
            assert 0.0 < getattr(nominal, field) <= getattr(harsh, field), field
    for depth_m in (0.3, 1.0, 2.0):
        stds = [
            level.depth_constant_m + level.depth_quadratic_per_m * (depth_m - level.depth_offset_m) ** 2
            for level in (nominal, harsh)
        ]
        assert stds[0] < stds[1]


@pytest.mark.parametrize(
    ("camera", "says"),
    [
        (f"{CAMERA}, width: 0", "at least 8"),
        (f"{CAMERA}, height: 99999", "at most 2048"),
        (f"{CAMERA}, latency_s: -0.1", "at least 0"),
        (f"{CAMERA}, range_m: [1.0, 0.5]", "the least value first, then the greatest"),
        (f"{CAMERA}, fx: 100", "given together"),
        (f"{CAMERA}, fx: 100, fy: 100, cx: 9, cy: 9", "either fovy_deg or fx"),
        ("position_m: [0, 0, 1], target_m: [0.1, 0, 0]", "either fovy_deg or fx"),
        ("position_m: [0, 0, 1], fovy_deg: 40", "needs position_m and target_m"),
        ("position_m: [0, 0, 1], target_m: [0, 0, 0], fovy_deg: 40", "up must not be parallel"),
        ("scene_camera: top, mount: hand", "has its place from the scene"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(tmp_path, camera, says):
    with pytest.raises(DefinitionError, match=says):
        read(tmp_path, camera)


def test_a_camera_of_the_scene_needs_no_place_of_its_own(tmp_path):
    assert read(tmp_path, "scene_camera: top").cameras["eye"].camera == CameraSettings(scene_camera="top")


@pytest.mark.parametrize(("modality", "camera"), [("rgbd", ""), ("depth", CAMERA)])
def test_an_rgbd_sensor_has_a_camera_and_no_other_has(tmp_path, modality, camera):
    with pytest.raises(DefinitionError, match="modality rgbd has a camera"):
        read(tmp_path, camera, modality)


def test_a_noise_level_that_nobody_knows_is_told_with_the_nearest_name(tmp_path):
    more = "noise_level: nominl\nnoise_levels: {nominal: {color_std: 2}}"

    with pytest.raises(DefinitionError, match=r"UNKNOWN_NAME \(noise level\).*nominal, none.*'nominal'"):
        read(tmp_path, more=more)


@pytest.mark.parametrize("noise", ["pixel_dropout: 1.2", "depth_constant_m: -1", "color_std: 1000", "frame_dropout: 1"])
def test_noise_beyond_its_bounds_is_refused(tmp_path, noise):
    with pytest.raises(DefinitionError, match="INVALID_VALUE"):
        read(tmp_path, more=f"noise_levels: {{bad: {{{noise}}}}}")


def test_a_file_without_noise_levels_has_perfect_cameras(tmp_path):
    assert read(tmp_path).get_noise() == NoiseLevel()
