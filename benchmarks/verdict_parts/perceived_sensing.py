"""What the verifier is shown when cameras look at the recorded states again, and a pipeline makes a belief of them.

Each case is a chain of looks: before the session, where sensors will lie also at the moment when everything was
right, and at the end; so the last look begins from the belief that a live pipeline would have had. Lying cameras stop
after the second look. A verdict that wants more evidence gets another exposure of the same cameras, twice at most.
"""

import msgspec
import mujoco
import numpy as np

from benchmarks.recorded import Robot
from benchmarks.verdict_parts.cases import Lie
from benchmarks.verdict_parts.truth_sensing import AGE_S, SILENT_S
from benchmarks.verdict_parts.worlds import OFF_TABLE_M, World
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.sessions.evidence import TRAJECTORY
from phyagentos.protocol.sessions.verdicts import Attempt
from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.protocol.world.environment import Environment, TargetState
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.drivers.mujoco.simulated_camera import open_cameras, pose_state
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.pipeline import Pipeline
from phyagentos.runtime.perception.robot_mask import RobotMask
from phyagentos.runtime.targets.wire import Frame, Frames

LOOKS_BEFORE = 2  # a session is preceded by a look at preflight, and begins with one
LATENCY_S = 0.04  # of the cameras that ship
LOOKS_AGAIN = 2  # at most, where the verdict wants more evidence; the arm stays where it is, unlike in an inspection
AGAIN_S = 0.4


class PerceivedSensing:
    """Cameras of one noise level, and the embedded pipeline.

    Args:
        level: Of the noise.
        robot: Who acts, and hides things.
        world: Of the cases.
    """

    def __init__(self, level: str, robot: Robot, world: World) -> None:
        self.level = level
        self._world = world
        self._scene = world.recorded.bundle.session.scene
        self._model = world.physics.model
        self._data = mujoco.MjData(self._model)
        sensors = read_sensors(find_shipped_root() / "protocol" / "sensors.yaml")
        self._cameras = open_cameras(self._model, sensors, seed=self._scene.seed, level=level)
        spec = read_scene(robot.library.get_scene(self._scene.name))
        mask, noisy = RobotMask(robot.profile, robot.folder), sensors.get_noise(level).varies
        named = {name: body for name, body in spec.bodies.items() if name not in world.recorded.job.unlisted}
        inventory = build_inventory(spec.model_copy(update={"bodies": named}))
        self._pipeline = Pipeline(inventory, mask, robot.profile.target, noisy=noisy)
        self._before = self._begin(np.random.default_rng(self._scene.seed))

    def judge(self, right: np.ndarray, now: np.ndarray, lie: Lie, rng: np.random.Generator) -> Attempt:
        """The verdict; the bundle is that of the recorded session with other snapshots."""
        world, before = self._world, self._before
        if lie is Lie.COVERED:
            before = self._begin(np.random.default_rng(self._scene.seed), world.object)
        belief = self._hold(before)
        world.restore(now)
        end_s = world.physics.time_s
        frames: tuple[Frame, ...] | None = None
        if lie is Lie.COVERED:
            self._take_away(world.object)
        elif lie not in {Lie.NONE, Lie.MOVING, Lie.BLIND, Lie.EARLIER}:
            world.restore(right)
            last_s = end_s - float(rng.uniform(*(SILENT_S if lie is Lie.SILENT else AGE_S)))
            frames = self._expose(last_s - LATENCY_S, rng)
            belief = self._sense(frames, last_s, belief)
            world.restore(now)
        match lie:
            case Lie.STALE:
                assert frames is not None
                shown = frames
            case Lie.SILENT | Lie.BLIND:
                shown = ()
            case Lie.FROZEN:
                assert frames is not None
                shown = tuple(msgspec.structs.replace(each, time_s=end_s - LATENCY_S) for each in frames)
            case _:
                shown = self._expose(end_s - LATENCY_S, rng)
        after = self._sense(shown, end_s, belief)
        attempt = self._ask(before, after, lie)
        for number in range(1, (0 if lie is Lie.MOVING else LOOKS_AGAIN) + 1):
            if not attempt.missing_evidence:
                break
            time_s = end_s + number * AGAIN_S
            if lie in {Lie.NONE, Lie.HIDDEN, Lie.COVERED, Lie.EARLIER}:
                shown = self._expose(time_s - LATENCY_S, rng)
            elif lie is Lie.FROZEN:
                shown = tuple(msgspec.structs.replace(each, time_s=time_s - LATENCY_S) for each in shown)
            after = self._sense(shown, time_s, after)
            attempt = self._ask(before, after, lie)
        return attempt

    def _take_away(self, thing: str) -> None:
        self._world.put(thing, np.array(OFF_TABLE_M))

    def _ask(self, before: Environment, after: Environment, lie: Lie) -> Attempt:
        from benchmarks.verdict_parts.sensing import judge_bundle

        return judge_bundle(self._world, before, after, lie)

    def _begin(self, rng: np.random.Generator, covered: str = "") -> Environment:
        """What is believed when the session begins; a covered thing was never seen."""
        world = self._world
        world.restore(world.recorded.before)
        if covered:
            self._take_away(covered)
        begin_s, belief = world.physics.time_s, None
        for number in range(LOOKS_BEFORE):
            time_s = begin_s - 0.1 * (LOOKS_BEFORE - 1 - number)
            belief = self._sense(self._expose(time_s - LATENCY_S, rng), time_s, belief)
        assert belief is not None
        return belief

    def _hold(self, belief: Environment) -> Environment:
        """The belief after the grasp, of a session that ends with something in the hand: touch told of it then."""
        bundle = self._world.recorded.bundle
        if bundle.session.skill != "pick":
            return belief
        with np.load(bundle.folder / TRAJECTORY) as file:
            course = {name: file[name] for name in file.files}
        narrowed = np.flatnonzero(course["gripper_measured_m"] < 0.9 * course["gripper_measured_m"].max())
        still = narrowed[np.abs(np.diff(course["gripper_measured_m"], append=0.0)[narrowed]) < 1e-5]
        row = int(still[0]) if still.size else int(narrowed[-1])
        for later in range(row, len(course["time_s"]), 5):
            state = self._read_past(course, later)
            belief = self._pipeline.recall(belief, state, float(course["time_s"][later]))
        return belief

    def _read_past(self, course: dict[str, np.ndarray], row: int) -> TargetState:
        """What the target said of itself in a recorded control period, with both fingers on something."""
        world = self._world
        world.restore(world.recorded.after)
        physics = world.physics
        physics.data.qpos[physics.state.q_address] = course["q_measured"][row]
        physics.queries.look()
        state = physics.queries.read_target({})
        width = float(course["gripper_measured_m"][row])
        return msgspec.structs.replace(state, gripper_width_m=width, grip_force_n=30.0, holding=())

    def _expose(self, time_s: float, rng: np.random.Generator) -> tuple[Frame, ...]:
        """The world as it is, as the cameras show it."""
        pose_state(self._model, self._world.physics.data.qpos, self._data)
        return tuple(camera.capture(self._data, time_s, rng) for camera in self._cameras.values())

    def _sense(self, frames: tuple[Frame, ...], time_s: float, before: Environment | None) -> Environment:
        physics = self._world.physics
        physics.queries.look()
        state = physics.queries.read_target(physics.queries.find_touching())
        return self._pipeline.sense(Frames(frames, {}), state, self._scene, time_s, before)
