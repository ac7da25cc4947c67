"""The embedded pipeline at work: asks the cameras when somebody asks it, and keeps the belief of one target.

Upstream: runner, preflight, leaves. Downstream: `pipeline`, and the handle for frames. A question at a moment that was
looked at already is answered from memory: in lockstep time stands between two sessions, and so does the picture.
"""

from collections import deque
from collections.abc import Collection, Mapping

import msgspec

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.world.environment import Environment, Status, TargetState
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.perception.belief import follow_hand
from phyagentos.runtime.perception.confirmation import is_settled
from phyagentos.runtime.perception.detection.detector import Detector
from phyagentos.runtime.perception.detection.segmentation import DetectorSegmenter
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.pipeline import MAX_AGE_S, Pipeline
from phyagentos.runtime.perception.regions_of_interest import Extrinsics, find_windows, is_overlapping
from phyagentos.runtime.perception.robot_mask import RobotMask
from phyagentos.runtime.perception.sensor_health import AHEAD_S, feel_pulses, find_pulses
from phyagentos.runtime.targets.wire import Crop, Frames, Observation, Step

SAME_S = 1e-9
STATES_KEPT = 32  # control periods: longer than any latency
GLANCE_CAMERAS = 1
LARGE_PX = 1200  # a window of so many pixels shows enough
THINNED = 3  # of whose rows and columns one is read out
PULSE_S = 0.5  # between two proofs that the cameras live: a frozen one is believed for twice this at most
MEMORY = 8  # scenes whose inventory is kept


class EmbeddedPerception:
    """Perceives with cameras (`sensing: perceived`).

    Args:
        target: Name of the target.
        handle: Gives frames.
        library: Where scenes are found.
        robot: Its solids.
        moving: Cameras that the robot carries.
        max_age_s: Older frames tell nothing of now.
        detector: Tells things apart instead of their colours.
        noisy: Whether the sensors declare noise, so that no picture comes twice.
    """

    needs_observation = False

    def __init__(
        self,
        target: str,
        handle: TargetSessionHandle,
        library: Library,
        robot: RobotMask,
        moving: Collection[str] = (),
        max_age_s: float = MAX_AGE_S,
        detector: Detector | None = None,
        *,
        noisy: bool = True,
    ) -> None:
        self._noisy = noisy
        self._detector = detector
        self._target, self._handle, self._library, self._robot = target, handle, library, robot
        self._moving, self._max_age_s = frozenset(moving), max_age_s
        self._pipelines: dict[str, Pipeline] = {}
        self._belief: Environment | None = None
        self._states: deque[tuple[float, TargetState]] = deque(maxlen=STATES_KEPT)

    def perceive(self, observation: Observation | Step, scene: Scene, focus: Collection[str] = ()) -> Environment:
        """Look, unless this moment was looked at already."""
        self._take(scene)
        self.note(observation.time_s, observation.target)
        before, pipeline = self._belief, self._get_pipeline(scene)  # touch asks it too, of a belief that was restored
        if before is not None and abs(before.looked_at_s - observation.time_s) < SAME_S:
            return before
        if focus and before is not None:
            return self._glance(pipeline, before, observation, scene, focus)
        before = self._feel_pulses(observation.time_s, 0.0)
        frames = self._handle.capture()
        now = self._catch_up(frames, observation)
        self._belief = pipeline.sense(frames, now.target, scene, now.time_s, before, find_state=self._find_state)
        return self._belief

    def recall(self, observation: Observation, scene: Scene) -> Environment:
        """The latest belief, what is held carried on; looks when there is none."""
        before = self._take(scene)
        if before is None:
            return self.perceive(observation, scene)
        self._belief = self._get_pipeline(scene).recall(before, observation.target, observation.time_s)
        return self._belief

    def note(self, time_s: float, state: TargetState) -> None:
        """Remember what the target said of itself, for frames that come later than they were taken."""
        if not self._states or time_s > self._states[-1][0] + SAME_S:
            self._states.append((time_s, state))
            self._feel_pulses(time_s, PULSE_S)

    def find_held(self, state: TargetState, time_s: float) -> tuple[str, ...]:
        """Names of the things between the fingers, by touch and by where things were."""
        before = self._belief
        if before is None or before.scene not in self._pipelines:
            return ()
        inventory = self._pipelines[before.scene].inventory
        entities = follow_hand(inventory, before.entities, state, self._target, time_s)
        self._belief = msgspec.structs.replace(before, entities=entities)
        return tuple(sorted(name for name, entity in entities.items() if entity.status is Status.HELD))

    def restore(self, belief: Environment) -> None:
        """Continue from a recorded belief, so that a session can be repeated from its evidence."""
        self._belief = belief if belief.sensing == "perceived" else None
        self._states.clear()

    def _glance(
        self,
        pipeline: Pipeline,
        before: Environment,
        observation: Observation | Step,
        scene: Scene,
        focus: Collection[str],
    ) -> Environment:
        """Look at some things only, where they should be, in the camera that saw them best."""
        carried = pipeline.recall(before, observation.target, observation.time_s)
        loose = [
            name
            for name in focus
            if (entity := carried.entities.get(name)) is not None
            and entity.movable
            and entity.status is not Status.HELD
        ]
        hidden = any(carried.entities[name].status is not Status.SEEN for name in loose)
        stands = {
            camera: stand
            for camera, health in before.sensors.items()
            if camera not in self._moving
            and health.status != "frozen"
            and (stand := Extrinsics.find(health)) is not None
        }
        most = len(stands) if hidden else GLANCE_CAMERAS
        windows = find_windows(loose, carried.entities, pipeline.inventory, stands, most)
        if not windows:
            self._belief = carried
            return carried
        confirmed = self._confirm(pipeline, carried, observation, loose, windows)
        if confirmed is not None:
            self._belief = confirmed
            return confirmed
        frames = self._handle.capture(tuple(windows), windows)
        now = self._catch_up(frames, observation)
        self._belief = pipeline.sense(
            frames, now.target, scene, now.time_s, carried, focus=frozenset(loose), find_state=self._find_state
        )
        return self._belief

    def _confirm(
        self,
        pipeline: Pipeline,
        carried: Environment,
        observation: Observation | Step,
        loose: Collection[str],
        windows: Mapping[str, Crop],
    ) -> Environment | None:
        """The belief, when a few pixels are enough to see that these things are where they were."""
        entities, things = carried.entities, pipeline.inventory.things
        if not pipeline.can_confirm or not all(is_settled(entities[name], things.get(name)) for name in loose):
            return None
        held = [name for name, entity in entities.items() if entity.status is Status.HELD and name in things]
        stands = {
            camera: stand for camera in windows if (stand := Extrinsics.find(carried.sensors[camera])) is not None
        }
        hands = find_windows(held, entities, pipeline.inventory, stands, len(stands))
        if any(is_overlapping(windows[camera], hand) for camera, hand in hands.items()):
            return None  # what the hand holds is looked at as well
        area = min(width * height for _, _, width, height in windows.values())
        frames = self._handle.capture(tuple(windows), dict(windows), THINNED if area >= LARGE_PX else 1)
        now = self._catch_up(frames, observation)
        if now is not observation:
            carried = pipeline.recall(carried, now.target, now.time_s)
        return pipeline.confirm(frames, now.target, now.time_s, carried, loose)

    def _catch_up(self, frames: Frames, observation: Observation | Step) -> Observation | Step:
        """The observation that frames belong to: a newer one where time went on before they were taken (realtime)."""
        if all(frame.time_s <= observation.time_s + AHEAD_S for frame in frames.frames):
            return observation
        now = self._handle.observe()
        self.note(now.time_s, now.target)
        newest_s = max((f.time_s for f in frames.frames if f.time_s <= now.time_s + AHEAD_S), default=now.time_s)
        return msgspec.structs.replace(now, time_s=newest_s, target=self._find_state(newest_s))

    def _feel_pulses(self, time_s: float, period_s: float) -> Environment | None:
        """The belief, with cameras known as frozen that are; asked for no more often than once in a period."""
        belief = self._belief
        if belief is None or not self._noisy:
            return belief
        windows = find_pulses(belief.sensors)
        latest_s = max((belief.sensors[camera].pulse_s for camera in windows), default=0.0)
        if windows and time_s - latest_s > max(period_s - SAME_S, SAME_S):
            frames = self._handle.capture(tuple(windows), windows)
            sensors = feel_pulses(frames, belief.sensors, time_s)
            self._belief = belief = msgspec.structs.replace(belief, sensors=sensors)
        return belief

    def _take(self, scene: Scene) -> Environment | None:
        """The belief, when it is of this episode."""
        belief = self._belief
        if belief is not None and belief.episode != scene.episode:
            self._belief = belief = None
            self._states.clear()
        return belief

    def _get_pipeline(self, scene: Scene) -> Pipeline:
        if scene.name not in self._pipelines:
            if len(self._pipelines) >= MEMORY:
                self._pipelines.clear()
            inventory = build_inventory(read_scene(self._library.get_scene(scene.name)))
            segmenter = DetectorSegmenter(self._detector, inventory) if self._detector is not None else None
            self._pipelines[scene.name] = Pipeline(
                inventory, self._robot, self._target, self._max_age_s, segmenter, noisy=self._noisy
            )
        return self._pipelines[scene.name]

    def _find_state(self, time_s: float) -> TargetState:
        """What the target said of itself nearest to a moment."""
        if not self._states:
            raise ExecutionError("NO_STATE", "the target has not said anything of itself yet")
        return min(self._states, key=lambda each: abs(each[0] - time_s))[1]
