"""A simulated RGB-D camera: one state of a model in, one frame out. Pure, but for its buffers.

To sense the recorded states of an evidence bundle again, open its model
(`mujoco.MjModel.from_binary_path("scene.mjb")`), then

    cameras = open_cameras(model, read_sensors(path), seed=7, level="harsh")
    data = pose_state(model, np.load("terminal.npz")["qpos"])
    frame = cameras["overhead"].capture(data, time_s=12.5, rng=np.random.default_rng(1))
"""

from dataclasses import replace
from typing import Protocol

import mujoco
import numpy as np

from phyagentos.geometry import as_pose, turn
from phyagentos.protocol.settings.sensors import CameraSettings, NoiseLevel, Sensors
from phyagentos.protocol.world.seeds import compute_seed
from phyagentos.runtime.drivers.mujoco.camera_noise import add_sensor_noise, blur, draw_places
from phyagentos.runtime.drivers.mujoco.ray_cast import RayCaster
from phyagentos.runtime.drivers.mujoco.rendering import GraphicsCaster
from phyagentos.runtime.drivers.mujoco.static_depth_cache import Picture, Shot
from phyagentos.runtime.models.camera_model import Array, Lens, Viewpoint, find_mounting
from phyagentos.runtime.targets.wire import Crop, Frame

Exposed = tuple[mujoco.MjData, mujoco.MjData | None]
"""States at the end of an exposure and, where something moved, at its beginning."""


class Caster(Protocol):
    """A back end: pictures of a perfect camera."""

    def cast(self, data: mujoco.MjData, shot: Shot) -> Picture:
        """One picture of a state with computed poses."""

    def shows_motion(self, data: mujoco.MjData, begin: mujoco.MjData, shot: Shot) -> bool:
        """Whether a picture may show that something moved since `begin`."""


class UnknownMountingError(LookupError):
    """The model lacks the camera's carrier."""


class SimulatedCamera:
    """One camera in one model; the seed draws its constant calibration error.

    Raises:
        UnknownMountingError: When the model lacks the body or the scene's camera that the settings name.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        name: str,
        settings: CameraSettings,
        noise: NoiseLevel,
        caster: Caster,
        seed: int = 0,
        prefix: str = "",
    ) -> None:
        mounting = find_mounting(model, settings, prefix)
        if mounting is None:
            raise UnknownMountingError(settings.scene_camera or settings.mount)
        self.name, self.settings, self.noise, self.mounting = name, settings, noise, mounting
        self._caster, self._still = caster, int(model.body_weldid[mounting.body]) == 0
        self._error = _draw_error(noise, compute_seed(seed, "sensors", name, "calibration"))

    def capture(
        self,
        data: mujoco.MjData,
        time_s: float,
        rng: np.random.Generator,
        crop: Crop | None = None,
        claimed: Viewpoint | None = None,
        every: int = 1,
        begin: mujoco.MjData | None = None,
    ) -> Frame:
        """One frame of a state with computed poses, as of `pose_state`, which is only read.

        Args:
            data: The state.
            time_s: Stamp of the frame.
            rng: Of this frame's noise.
            crop: Window to look at instead of the whole picture.
            claimed: Reported pose; the nominal one in this state when absent.
            every: Of so many rows and columns only the middle one is read out; odd.
            begin: State at the beginning of the exposure, where something moved since.

        Raises:
            ExecutionError: `REQUEST_INVALID`, or `NO_GRAPHICS` of the back end that draws.
        """
        whole = self.mounting.lens
        lens = whole if crop is None else whole.crop(crop)
        nominal = self.mounting.find(data)
        true = nominal.then(self._error)
        low, high = self.settings.range_m
        shot = Shot(lens, true, high, still=self._still, whole=whole, corner=crop[:2] if crop else (0, 0))
        if every == 1:
            picture, focal_px = self._cast((data, begin), shot), lens.fx
        else:
            lens, focal_px = lens.thin(every), 0.0
            picture = self._cast_some((data, begin), shot, lens, every, rng)
        rgb, depth = add_sensor_noise(picture, self.noise, focal_px, (low, high), rng)
        claimed = claimed or nominal
        return Frame(
            camera=self.name,
            time_s=time_s,
            width=lens.width,
            height=lens.height,
            fx=lens.fx,
            fy=lens.fy,
            cx=lens.cx,
            cy=lens.cy,
            world_T_camera=as_pose(claimed.rotation, claimed.position_m),
            rgb=rgb,
            depth_m=depth,
        )

    def _cast(self, states: Exposed, shot: Shot) -> Picture:
        data, begin = states
        picture = self._caster.cast(data, shot)
        if begin is None or not self._caster.shows_motion(data, begin, shot):
            return picture
        return blur(
            picture, self._caster.cast(begin, replace(shot, viewpoint=self.mounting.find(begin).then(self._error)))
        )

    def _cast_some(self, states: Exposed, shot: Shot, thin: Lens, every: int, rng: np.random.Generator) -> Picture:
        """The pixels of a thinned picture: colours at their centres, depths at their wavering places."""
        shape = (thin.height, thin.width)
        middles = np.indices(shape, dtype=np.intp) * every + every // 2
        std_px = self.noise.lateral_std_rad * shot.lens.fx
        places = draw_places(shape, every, std_px, rng) if std_px > 0.0 else middles
        rows, columns = np.concatenate((middles, places), axis=1).reshape(2, -1)
        picture = self._cast(states, replace(shot, pixels=(rows, columns)))
        both = picture.reshape((2 * thin.height, thin.width))
        n = thin.height
        return Picture(both.rgb[:n], both.depth_m[n:], both.incidence[n:], both.finish[n:])


def open_cameras(
    model: mujoco.MjModel, sensors: Sensors, *, seed: int, level: str = "", prefix: str = ""
) -> dict[str, SimulatedCamera]:
    """The cameras of sensors.yaml that a model can carry.

    An empty `level` of noise is the file's choice; `prefix` is of the names of the robot that carries some of them.

    Raises:
        KeyError: When there is no such noise level.
    """
    noise = sensors.get_noise(level)
    caster: Caster = RayCaster(model) if sensors.backend == "ray" else GraphicsCaster(model)
    cameras: dict[str, SimulatedCamera] = {}
    for name, sensor in sensors.cameras.items():
        if sensor.camera is None:
            continue
        try:
            cameras[name] = SimulatedCamera(model, name, sensor.camera, noise, caster, seed, prefix)
        except UnknownMountingError:
            continue
    return cameras


def pose_state(model: mujoco.MjModel, qpos: Array, data: mujoco.MjData | None = None) -> mujoco.MjData:
    """The poses of all bodies, cameras and lights for joint positions (nq,), in `data` or a new one."""
    data = mujoco.MjData(model) if data is None else data
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_camlight(model, data)
    return data


def _draw_error(noise: NoiseLevel, seed: int) -> Viewpoint:
    """`claimed_T_true` of a camera."""
    rng = np.random.default_rng(seed)
    shift = rng.normal(size=3) * noise.calibration_position_m
    return Viewpoint(shift, turn(rng.normal(size=3) * noise.calibration_rotation_rad))
