"""The cameras of one episode: the frame each can give now, its exposure time, and its corruption by faults.

Exposures fall on the control periods of simulated time; a frame is available one latency later. Every random number
follows from the scene's seed, the episode, the camera and the number of the exposure: a repeated run sees the same
bits, however often frames are read.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import msgspec
import mujoco
import numpy as np

from phyagentos.errors import ExecutionError, format_names
from phyagentos.geometry import turn
from phyagentos.protocol.settings.sensors import Sensors
from phyagentos.protocol.world.seeds import compute_seed
from phyagentos.runtime.drivers.mujoco.faults import FaultActivation
from phyagentos.runtime.drivers.mujoco.joint_controller import StateHistory
from phyagentos.runtime.drivers.mujoco.simulated_camera import SimulatedCamera, open_cameras, pose_state
from phyagentos.runtime.models.camera_model import Array, Viewpoint
from phyagentos.runtime.targets.wire import Capture, Crop, Frame, Frames

MAX_LOST = 16  # frames in a row, before a camera has none to give
LOSSES_KEPT = 512  # exposures of which it is remembered whether they were lost
STILL = 1e-3  # greatest change of a joint in an exposure that no pixel shows [rad, m]
_PHASE_TOLERANCE = 1e-6  # of an exposure: 0.06 s times 50 Hz is not exactly 3
_UNCORRUPTED: tuple[FaultActivation, ...] = ()

FindCorruption = Callable[[str], tuple[FaultActivation, ...]]


@dataclass(frozen=True, slots=True)
class Exposure:
    """One exposure of one camera, counted since time zero, and the states (nq,) at its end and, if moved, its begin."""

    number: int
    time_s: float
    qpos: Array
    begin: Array | None = None


class CameraRig:
    """All cameras in one model; `prefix` is of the names of the robot that carries some of them."""

    def __init__(self, model: mujoco.MjModel, sensors: Sensors, seed: int, episode: str, prefix: str = "") -> None:
        self._model, self._sensors, self._seed, self._episode = model, sensors, seed, episode
        self._cameras = open_cameras(model, sensors, seed=seed, prefix=prefix)
        self._states: dict[str, tuple[mujoco.MjData, mujoco.MjData]] = {}  # those that each camera shows: end and begin
        self._lost: dict[tuple[str, int], bool] = {}  # which exposures were lost, as drawn

    @property
    def names(self) -> tuple[str, ...]:
        """The cameras that this model can carry."""
        return tuple(self._cameras)

    def capture(
        self,
        request: Capture,
        now_s: float,
        history: StateHistory,
        find_corruption: FindCorruption = lambda _camera: _UNCORRUPTED,
    ) -> Frames:
        """The latest frames at simulated time `now_s`, with the active faults of each camera.

        Raises:
            ExecutionError: `REQUEST_INVALID`.
        """
        names = request.cameras or self.names
        for name in (*names, *request.crops):
            if name not in self._cameras:
                raise ExecutionError(
                    "REQUEST_INVALID", f"no camera {name!r} in this world; there are {format_names(self._cameras)}"
                )
        latest_s = now_s - max((self._cameras[name].settings.latency_s for name in names), default=0.0)
        exposures: dict[str, tuple[Exposure, tuple[FaultActivation, ...]]] = {}
        missing: dict[str, str] = {}
        for name in names:
            camera = self._cameras[name]
            limit_s = latest_s if self._sensors.synchronised else now_s - camera.settings.latency_s
            exposure = self._find_exposure(camera, limit_s, history)
            corruptions = find_corruption(name)
            if exposure is None or any(each.kind == "blackout" and each.mode == "silent" for each in corruptions):
                missing[name] = "OBSERVATION_UNAVAILABLE"
            else:
                exposures[name] = exposure, corruptions

        def expose(name: str) -> Frame | None:
            try:
                return self._expose(self._cameras[name], *exposures[name], request.crops.get(name), request.every)
            except ExecutionError as error:
                if error.code != "NO_GRAPHICS":
                    raise
                missing[name] = error.code
                return None

        if len(exposures) > 1 and not request.crops and self._sensors.backend == "ray":  # whole pictures, side by side
            with ThreadPoolExecutor(len(exposures), "camera") as pool:
                frames = list(pool.map(expose, exposures))
        else:
            frames = [expose(name) for name in exposures]
        return Frames(tuple(frame for frame in frames if frame is not None), missing)

    def _find_exposure(self, camera: SimulatedCamera, limit_s: float, history: StateHistory) -> Exposure | None:
        """The latest exposure up to a moment whose frame was not lost; None after `MAX_LOST` lost ones."""
        phase_s = 0.0 if self._sensors.synchronised else camera.settings.phase_s
        rate_hz = self._sensors.sensors[camera.name].rate_hz
        latest = int(np.floor((limit_s - phase_s) * rate_hz + _PHASE_TOLERANCE))
        for number in range(latest, latest - MAX_LOST, -1):
            if not self._is_lost(camera, number):
                time_s, qpos = history.find(number / rate_hz + phase_s)
                begin = history.interpolate(time_s - camera.noise.exposure_s) if camera.noise.exposure_s else qpos
                return Exposure(number, time_s, qpos, begin if np.abs(begin - qpos).max() > STILL else None)
        return None

    def _is_lost(self, camera: SimulatedCamera, number: int) -> bool:
        chance = camera.noise.frame_dropout
        if chance <= 0.0:
            return False
        key = (camera.name, number)
        if key not in self._lost:
            if len(self._lost) > LOSSES_KEPT:
                self._lost.clear()
            self._lost[key] = bool(self._draw(camera.name, "lost", number).random() < chance)
        return self._lost[key]

    def _draw(self, camera: str, purpose: str, number: int) -> np.random.Generator:
        return np.random.default_rng(compute_seed(self._seed, "sensors", self._episode, camera, purpose, number))

    def _expose(
        self,
        camera: SimulatedCamera,
        exposure: Exposure,
        corruptions: tuple[FaultActivation, ...],
        crop: Crop | None,
        every: int,
    ) -> Frame:
        claimed = shown = exposure
        pose: Viewpoint | None = None
        for each in corruptions:
            if each.kind == "freeze":
                number = int(each.time_s * self._sensors.sensors[camera.name].rate_hz)
                shown = Exposure(number, each.time_s, np.array(each.qpos))
                claimed = exposure if each.mode == "fresh" else shown
        for each in corruptions:
            if each.kind == "miscalibrate":
                error = Viewpoint(np.array(each.by_m), turn(np.array(each.by_rad)))
                pose = (pose or self._find_place(camera, claimed)).then(error)
        if claimed is not shown:
            pose = pose or self._find_place(camera, claimed)
        end, start = self._get_states(camera)
        data = pose_state(self._model, shown.qpos, end)
        begin = None if shown.begin is None else pose_state(self._model, shown.begin, start)
        rng = self._draw(camera.name, "frame", shown.number)
        frame = camera.capture(data, claimed.time_s, rng, crop, pose, every, begin)
        frame = msgspec.structs.replace(frame, number=shown.number)
        for each in corruptions:
            frame = _alter(frame, each)
        return frame

    def _find_place(self, camera: SimulatedCamera, exposure: Exposure) -> Viewpoint:
        """Nominal pose of a camera in a state."""
        return camera.mounting.find(pose_state(self._model, exposure.qpos, self._get_states(camera)[0]))

    def _get_states(self, camera: SimulatedCamera) -> tuple[mujoco.MjData, mujoco.MjData]:
        if camera.name not in self._states:
            self._states[camera.name] = mujoco.MjData(self._model), mujoco.MjData(self._model)
        return self._states[camera.name]


def _alter(frame: Frame, corruption: FaultActivation) -> Frame:
    if corruption.kind == "misdate":
        return msgspec.structs.replace(frame, time_s=frame.time_s + corruption.by_s)
    if corruption.kind == "blackout":
        black, nothing = np.zeros_like(frame.rgb), np.full_like(frame.depth_m, np.nan)
        return msgspec.structs.replace(frame, rgb=black, depth_m=nothing)
    return frame
