"""sensors.yaml: what can be observed in this workspace, and how often; place, lens, latency and noise of RGB-D cameras.

A camera's frame follows OpenCV: z forward, x right, y down.
"""

from pathlib import Path
from typing import Literal

import pydantic

from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.schema import Authored, Span, misfit, read_yaml, validate

Number3 = tuple[float, float, float]
CameraBackend = Literal["ray", "render"]
Modality = Literal["simulator_state", "proprioception", "rgb", "depth", "rgbd", "contact"]
ElementType = Literal["float64", "float32", "uint8", "uint16", "int32", "bool"]
Length = int | Literal["n_joints"]

MAX_PIXELS = 2048  # of one side
WORLD = "world"
PERFECT = "none"  # the noise level that every file has


class CameraSettings(Authored):
    """One RGB-D camera: colour and depth through the same lens.

    It stands at `position_m` and looks at `target_m`, both in the frame of `mount`; or it is a camera of the
    scene, named by `scene_camera`.

    Attributes:
        scene_camera: Name of a camera in the scene file; its pose, and its opening unless one is given here.
        mount: Body that carries it: `world`, or a part of the robot (`hand`).
        position_m: (3,) in the frame of the mount [m].
        target_m: (3,) a point that it looks at, in the frame of the mount [m].
        up: (3,) direction of the mount's frame that is up in the picture.
        width: Of the picture [pixels].
        height: Of the picture [pixels].
        fovy_deg: Vertical opening [deg], with square pixels and the axis in the middle; absent with fx and the others.
        fx: Focal length [pixels].
        fy: Focal length [pixels].
        cx: Column of the optical axis [pixels], counted from the left edge of the picture.
        cy: Row of the optical axis [pixels], counted from the upper edge of the picture.
        range_m: Nearest and farthest depth that is measured [m].
        latency_s: Time from the exposure to the moment when the frame can be had [s].
        phase_s: Start of its exposures against the other cameras; only without `synchronised` [s].
    """

    scene_camera: str = ""
    mount: str = WORLD
    position_m: Number3 | None = None
    target_m: Number3 | None = None
    up: Number3 = (0.0, 0.0, 1.0)
    width: int = pydantic.Field(default=192, ge=8, le=MAX_PIXELS)
    height: int = pydantic.Field(default=144, ge=8, le=MAX_PIXELS)
    fovy_deg: float | None = pydantic.Field(default=None, ge=5.0, le=120.0)
    fx: float | None = pydantic.Field(default=None, gt=0.0, le=1e5)
    fy: float | None = pydantic.Field(default=None, gt=0.0, le=1e5)
    cx: float | None = pydantic.Field(default=None, ge=-MAX_PIXELS, le=2.0 * MAX_PIXELS)
    cy: float | None = pydantic.Field(default=None, ge=-MAX_PIXELS, le=2.0 * MAX_PIXELS)
    range_m: Span = (0.1, 4.0)
    latency_s: float = pydantic.Field(default=0.0, ge=0.0, le=0.9)
    phase_s: float = pydantic.Field(default=0.0, ge=0.0, le=0.1)

    @pydantic.model_validator(mode="after")
    def _check_place(self) -> "CameraSettings":
        if self.scene_camera and (self.position_m or self.target_m or self.mount != WORLD):
            raise ValueError("a scene_camera has its place from the scene; leave out mount, position_m and target_m")
        if self.scene_camera:
            return self
        if self.position_m is None or self.target_m is None:
            raise ValueError("a camera needs position_m and target_m, or a scene_camera")
        forward = [there - here for there, here in zip(self.target_m, self.position_m, strict=True)]
        x, y, z = forward
        u, v, w = self.up
        aside = (y * w - z * v, z * u - x * w, x * v - y * u)
        if sum(value * value for value in aside) < 1e-8 * sum(value * value for value in forward):
            raise ValueError("up must not be parallel to the direction of view, and position_m not equal to target_m")
        return self

    @pydantic.model_validator(mode="after")
    def _check_lens(self) -> "CameraSettings":
        given = [value is not None for value in (self.fx, self.fy, self.cx, self.cy)]
        if any(given) and not all(given):
            raise ValueError("fx, fy, cx and cy are given together")
        if all(given) == (self.fovy_deg is not None) and (all(given) or not self.scene_camera):
            raise ValueError("a camera needs either fovy_deg or fx, fy, cx and cy")
        low, high = self.range_m
        if not 0.0 < low < high <= 100.0:
            raise misfit("range_m", "two rising distances above 0, at most 100 m")
        return self


class NoiseLevel(Authored):
    """What spoils pictures and their placing. All zero is a perfect camera.

    The standard deviation of depth z [m] on a surface that is turned away by the angle a [rad] is
    `depth_constant_m + depth_quadratic_per_m * (z - depth_offset_m)^2 + depth_grazing * a^2 / (sqrt(z) (pi/2 - a)^2)`,
    the last term above 60 degrees: C. V. Nguyen, S. Izadi, D. Lovell, "Modeling Kinect Sensor Noise for Improved 3D
    Reconstruction and Tracking", 3DIMPVT 2012, doi:10.1109/3DIMPVT.2012.84. The quadratic growth is that of
    triangulation: K. Khoshelham, S. O. Elberink, Sensors 12(2), 2012, doi:10.3390/s120201437.

    Attributes:
        color_std: Of each channel, of 255.
        depth_constant_m: See above [m].
        depth_quadratic_per_m: See above [1/m].
        depth_offset_m: See above [m].
        depth_grazing: See above [m^1.5].
        depth_unit_m: Quantization step of depth [m]; 0 for none.
        lateral_std_rad: How far, as an angle, the edges of objects waver in the picture [rad].
        pixel_dropout: Chance of a pixel to have no depth.
        glass_dropout: Chance of a pixel on glass to have no depth, besides `pixel_dropout`.
        black_dropout: The same on a black surface.
        exposure_s: Time over which a picture is taken; what moves meanwhile is blurred, and has no depth at its edges.
        frame_dropout: Chance of a frame to be lost; the one before it is then the latest.
        calibration_position_m: Standard deviation per axis of a camera's calibrated position [m].
        calibration_rotation_rad: Standard deviation per axis of its calibrated orientation [rad].
    """

    color_std: float = pydantic.Field(default=0.0, ge=0.0, le=128.0)
    depth_constant_m: float = pydantic.Field(default=0.0, ge=0.0, le=0.5)
    depth_quadratic_per_m: float = pydantic.Field(default=0.0, ge=0.0, le=0.5)
    depth_offset_m: float = pydantic.Field(default=0.0, ge=0.0, le=10.0)
    depth_grazing: float = pydantic.Field(default=0.0, ge=0.0, le=0.1)
    depth_unit_m: float = pydantic.Field(default=0.0, ge=0.0, le=0.1)
    lateral_std_rad: float = pydantic.Field(default=0.0, ge=0.0, le=0.1)
    pixel_dropout: float = pydantic.Field(default=0.0, ge=0.0, lt=1.0)
    glass_dropout: float = pydantic.Field(default=0.0, ge=0.0, le=1.0)
    black_dropout: float = pydantic.Field(default=0.0, ge=0.0, le=1.0)
    exposure_s: float = pydantic.Field(default=0.0, ge=0.0, le=0.1)
    frame_dropout: float = pydantic.Field(default=0.0, ge=0.0, lt=1.0)
    calibration_position_m: float = pydantic.Field(default=0.0, ge=0.0, le=0.5)
    calibration_rotation_rad: float = pydantic.Field(default=0.0, ge=0.0, le=0.5)

    @property
    def varies(self) -> bool:
        """Whether two pictures of a still scene differ."""
        return self.color_std > 0.0 or self.depth_constant_m > 0.0 or self.depth_quadratic_per_m > 0.0


class Signal(Authored):
    """The form of one measurement, where it is an array.

    Attributes:
        shape: Lengths of its axes; empty for one number. `n_joints` is the target's number of joints.
        dtype: Of its elements.
        unit: Of its elements, empty for none.
    """

    shape: tuple[Length, ...] = ()
    dtype: ElementType = "float64"
    unit: str = ""


class Sensor(Authored):
    """One source of observations.

    Attributes:
        modality: What it measures.
        frame: Frame of its measurements.
        rate_hz: In the target's own time [Hz].
        provides: What it measures, by the names that perception.yaml and skills use.
        signals: The form of what it measures, by these names; a policy needs it, a tree does not.
        camera: The camera that it is, for the modality `rgbd`.
        description: One sentence for people.
    """

    modality: Modality
    frame: str = "world"
    rate_hz: float = pydantic.Field(gt=0)
    provides: tuple[str, ...]
    signals: dict[str, Signal] = {}
    camera: CameraSettings | None = None
    description: str = ""

    @pydantic.model_validator(mode="after")
    def _check_camera(self) -> "Sensor":
        if (self.modality == "rgbd") != (self.camera is not None):
            raise ValueError("a sensor of the modality rgbd has a camera, and no other has one")
        return self


class Sensors(Authored):
    """sensors.yaml.

    Attributes:
        version: Of this format.
        sensors: By name.
        backend: How simulated cameras see: `ray` casts rays and needs no graphics, `render` draws with them.
        synchronised: Whether all cameras expose at the same moments; otherwise each from its own `phase_s` on.
        noise_level: Which of `noise_levels` spoils their pictures; `none` is always there.
        noise_levels: By name.
    """

    version: Literal[1] = 1
    sensors: dict[str, Sensor]
    backend: CameraBackend = "ray"
    synchronised: bool = True
    noise_level: str = PERFECT
    noise_levels: dict[str, NoiseLevel] = {}

    @property
    def cameras(self) -> dict[str, Sensor]:
        """The RGB-D cameras, by name."""
        return {name: sensor for name, sensor in self.sensors.items() if sensor.camera is not None}

    def get_noise(self, level: str = "") -> NoiseLevel:
        """A noise level by its name; the chosen one when none is given. Raises KeyError for an unknown one."""
        name = level or self.noise_level
        return self.noise_levels.get(name, NoiseLevel()) if name == PERFECT else self.noise_levels[name]


def find_sensor(sensors: Sensors, observation: str) -> tuple[str, Sensor] | None:
    """The first sensor that provides an observation, with its name."""
    return next(((name, each) for name, each in sensors.sensors.items() if observation in each.provides), None)


def find_source(sensors: Sensors, observation: str, frame: str) -> tuple[str, Sensor] | None:
    """The sensor that provides an observation in a frame; the first one that provides it at all where none does."""
    found = ((name, s) for name, s in sensors.sensors.items() if observation in s.provides and s.frame == frame)
    return next(found, find_sensor(sensors, observation))


def read_sensors(path: Path) -> Sensors:
    """Read sensors.yaml; raises DefinitionError with every problem at file:line:column."""
    located = read_yaml(path)
    sensors = validate(Sensors, located)
    levels = dict.fromkeys((PERFECT, *sensors.noise_levels))
    if sensors.noise_level not in levels:
        raise DefinitionError(located.unknown("noise level", ("noise_level",), sensors.noise_level, levels))
    return sensors
