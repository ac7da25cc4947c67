"""The world by cameras: captures when it is observed, and keeps the belief of one target.

A second question at the same moment is answered from memory: in lockstep, time stands between two sessions.
"""

from collections import deque
from collections.abc import Collection, Sequence

import msgspec
from typing_extensions import override

from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import read_placed
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.looks import FORMAT
from phyagentos.protocol.settings.perception import Prior
from phyagentos.protocol.world.environment import Environment, Status, TargetState
from phyagentos.runtime.perception.articulated import place_articulated
from phyagentos.runtime.perception.belief import lose_sight
from phyagentos.runtime.perception.confirmation import find_regions_of_interest, is_settled
from phyagentos.runtime.perception.detection.detector import Detector
from phyagentos.runtime.perception.inventory import build_inventory
from phyagentos.runtime.perception.look import FrameSource, Look, Moment, RecordedFrames
from phyagentos.runtime.perception.pipeline import MAX_AGE_S, Pipeline
from phyagentos.runtime.perception.robot_mask import RobotMask
from phyagentos.runtime.perception.segmentation import DetectorSegmenter
from phyagentos.runtime.perception.sensor_health import AHEAD_S, DISPLACED, check_probes, find_probe_regions
from phyagentos.runtime.perception.world_model import ConfirmationCapture, Need, WorldModel
from phyagentos.runtime.targets.wire import Capture, Crop, Frames, Step

SAME_S = 1e-9
STATES_KEPT = 32  # control periods: longer than any latency
GLANCE_CAMERAS = 1
LARGE_PX = 1200  # a window of so many pixels shows enough
THINNED = 3  # of whose rows and columns one is read out
PROBE_PERIOD_S = 0.5  # between two proofs that the cameras live: a frozen one is believed for twice this at most
MEMORY = 8  # inventories that are kept


class PerceivedWorld(WorldModel):
    """Perceives with cameras (`sensing: perceived`), of which the robot carries the `moving` ones.

    Frames older than `max_age_s` are ignored. A detector labels pixels instead of their colours. Pictures of `noisy`
    sensors never repeat; those of others do while nothing moves.
    """

    def __init__(
        self,
        target: str,
        handle: FrameSource,
        library: Library,
        robot: RobotMask,
        moving: Collection[str] = (),
        max_age_s: float = MAX_AGE_S,
        detector: Detector | None = None,
        *,
        noisy: bool = True,
        prior: Prior = Prior.FULL,
        profile: TargetProfile | None = None,
    ) -> None:
        super().__init__(target, handle, profile)
        self._noisy, self._prior = noisy, prior
        self._detector = detector
        self._library, self._robot = library, robot
        self._moving, self._max_age_s = frozenset(moving), max_age_s
        self._pipelines: dict[tuple[object, ...], Pipeline] = {}
        self._belief: Environment | None = None
        self._states: deque[Moment] = deque(maxlen=STATES_KEPT)
        self._look: Look | None = None  # that goes on

    @override
    def advance(self, step: Step, *, stands: bool = True) -> None:
        super().advance(step, stands=stands)
        self._note((step.time_s, step.target), stands=stands)

    @override
    def restore(self, belief: Environment, looks: Collection[Look] = ()) -> None:
        super().restore(belief, looks)
        self._belief = belief if belief.sensing == "perceived" else None
        self._states.clear()

    def repeat(self, look: Look) -> Environment:
        """The world of an earlier look, perceived again from its recorded readings.

        Raises:
            ExecutionError: `CHANGED` where perception now reads something else.
        """
        self._handle = RecordedFrames(look)
        self._belief = look.before
        self._states = deque(sorted(look.states, key=lambda each: each[0]), maxlen=STATES_KEPT)
        self.enter(look.scene)
        return self.observe(Need(everything=not look.objects, objects=frozenset(look.objects)))

    @override
    def observe(self, need: Need) -> Environment:
        if (present := self._find_present(need)) is not None:
            return present
        moment = self._handle.latest or self._handle.observe()
        now, before = (moment.time_s, moment.target), self._take()
        if before is not None and not need.is_look:
            return self._believe(self._get_pipeline().recall(before, now[1], now[0]), need)
        if before is not None and abs(before.looked_at_s - now[0]) < SAME_S:  # looked at already
            self._note(now)
            self.latest_look = self.looks[-1] if self.looks else None
            return self._answer(before, need)
        look = self._look = self._begin_look(now, before, need)
        try:
            self._note(now)
            if look.objects:
                found = self._perceive_objects(now, look.objects)
            else:
                self._probe_cameras(now[0], 0.0)
                frames = self._handle.capture()
                look.captures.append((Capture(), frames))
                now = self._catch_up(frames, now)
                found = self._get_pipeline().sense(
                    frames, now[1], self._scene, now[0], self._belief, find_state=self._find_state
                )
        finally:
            self._look = None
        self._keep(look, found)
        return self._believe(found, need)

    @override
    def plan_confirmation(self, objects: frozenset[str], time_s: float) -> ConfirmationCapture | None:
        belief = self._take()
        if belief is None:
            return None
        window: Capture | None = None
        if objects:
            latest = self.step
            carried = self._get_pipeline().recall(belief, latest.target, latest.time_s)
            window = self._plan_window(carried, *self._find_regions(carried, objects))
            if window is None:
                return None
        return ConfirmationCapture(objects, window, self._plan_probe(time_s, PROBE_PERIOD_S))

    @override
    def read_confirmation(self, confirmation: ConfirmationCapture, frames: Sequence[Frames]) -> Environment | None:
        now, pipeline = (self.step.time_s, self.step.target), self._get_pipeline()
        if confirmation.probe is not None:
            self._note_probe(frames[0], now[0])
        before = self._belief
        if confirmation.window is None or before is None:
            return None
        shown = frames[-1]
        carried = pipeline.recall(before, now[1], now[0])
        loose, regions = self._find_regions(carried, confirmation.objects)
        is_early = any(frame.time_s > now[0] + AHEAD_S for frame in shown.frames)
        if is_early or self._plan_window(carried, loose, regions) != confirmation.window:
            return None
        look = self._begin_look(now, before, Need(objects=confirmation.objects))
        look.captures.append((confirmation.window, shown))
        if (confirmed := pipeline.confirm(shown, now[1], now[0], carried, loose)) is None:
            return None
        self._keep(look, confirmed)
        return self._believe(confirmed, Need(objects=confirmation.objects))

    def _begin_look(self, now: Moment, before: Environment | None, need: Need) -> Look:
        """A record of the coming look; the first one covers everything."""
        return Look(
            phy=FORMAT,
            target=self._target,
            scene=self._scene,
            before=before,
            objects=() if before is None else tuple(sorted(need.objects)),
            now=now,
            states=list(self._states)[-1:],
        )

    def _believe(self, world: Environment, need: Need) -> Environment:
        self._belief = world
        return self._answer(world, need)

    def _perceive_objects(self, now: Moment, objects: Collection[str]) -> Environment:
        """Looks at some objects only, at their believed places, in the camera that saw them best."""
        before, pipeline = self._belief, self._get_pipeline()
        assert before is not None, "at first everything is looked at"
        carried = pipeline.recall(before, now[1], now[0])
        loose, regions = self._find_regions(carried, objects)
        if not regions:
            unseen = place_articulated(pipeline.inventory.articulated, lose_sight(carried.entities, loose))
            return msgspec.structs.replace(carried, entities=unseen)
        if (window := self._plan_window(carried, loose, regions)) is not None:
            frames = self._capture(window)
            later = self._catch_up(frames, now)
            if later is not now:
                carried = pipeline.recall(carried, later[1], later[0])
            confirmed = pipeline.confirm(frames, later[1], later[0], carried, loose)
            if confirmed is not None:
                return confirmed
        frames = self._capture(Capture(cameras=tuple(regions), crops=regions))
        now = self._catch_up(frames, now)
        return pipeline.sense(
            frames, now[1], self._scene, now[0], carried, focus=frozenset(loose), find_state=self._find_state
        )

    def _find_regions(self, carried: Environment, objects: Collection[str]) -> tuple[list[str], dict[str, Crop]]:
        """Those of the objects that may move by themselves, and the windows that show them."""
        articulated = self._get_pipeline().inventory.articulated
        loose = [
            name
            for name in sorted({articulated[name].part if name in articulated else name for name in objects})
            if (entity := carried.entities.get(name)) is not None
            and entity.movable
            and entity.status is not Status.HELD
        ]
        hidden = any(carried.entities[name].status is not Status.SEEN for name in loose)
        cameras = {
            camera: health
            for camera, health in carried.sensors.items()
            if camera not in self._moving and health.status not in {"frozen", DISPLACED} and health.pose is not None
        }
        return loose, find_regions_of_interest(
            loose,
            carried.entities,
            inventory=self._get_pipeline().inventory,
            cameras=cameras,
            most=len(cameras) if hidden else GLANCE_CAMERAS,
        )

    def _plan_window(self, carried: Environment, loose: Collection[str], regions: dict[str, Crop]) -> Capture | None:
        """The frames that may confirm that these objects did not move; None where they have to be fitted."""
        pipeline = self._get_pipeline()
        entities, objects = carried.entities, pipeline.inventory.objects
        if not regions or not pipeline.can_confirm:
            return None
        if not all(is_settled(entities[name], objects.get(name)) for name in loose):
            return None
        area = min(width * height for _, _, width, height in regions.values())
        return Capture(cameras=tuple(regions), crops=regions, every=THINNED if area >= LARGE_PX else 1)

    def _capture(self, request: Capture) -> Frames:
        """Frames, recorded by the current look."""
        frames = self._handle.capture(request.cameras, request.crops, request.every)
        if self._look is not None:
            self._look.captures.append((request, frames))
        return frames

    def _catch_up(self, frames: Frames, now: Moment) -> Moment:
        """The moment of the frames: a newer one where time passed before their capture (realtime)."""
        if all(frame.time_s <= now[0] + AHEAD_S for frame in frames.frames):
            return now
        newer = self._handle.observe()
        later = (newer.time_s, newer.target)
        if self._look is not None:
            self._look.moments.append(later)
        self._note(later)
        newest_s = max((f.time_s for f in frames.frames if f.time_s <= later[0] + AHEAD_S), default=later[0])
        return newest_s, self._find_state(newest_s)

    def _note(self, now: Moment, *, stands: bool = True) -> None:
        """Remember the target's state, for frames with latency."""
        if not self._states or now[0] > self._states[-1][0] + SAME_S:
            self._states.append(now)
            if stands:
                self._probe_cameras(now[0], PROBE_PERIOD_S)

    def _probe_cameras(self, time_s: float, period_s: float) -> None:
        """Mark frozen cameras in the belief; probes at most once in a period."""
        if probe := self._plan_probe(time_s, period_s):
            self._note_probe(self._capture(probe), time_s)

    def _plan_probe(self, time_s: float, period_s: float) -> Capture | None:
        """The windows of a probe, or whole pictures of cameras without noise; None within a period of the latest."""
        belief = self._belief
        if belief is None or not (regions := find_probe_regions(belief.sensors)):
            return None
        each = [belief.sensors[camera] for camera in regions]
        latest_s = max(health.probed_s if self._noisy else health.time_s for health in each)
        if time_s - latest_s <= max(period_s - SAME_S, SAME_S):
            return None
        if self._noisy:
            return Capture(cameras=tuple(regions), crops=regions)
        return Capture(cameras=tuple(regions)) if period_s > 0.0 else None  # the look itself shows whole pictures

    def _note_probe(self, frames: Frames, time_s: float) -> None:
        if self._belief is None:
            return
        if self._noisy:
            sensors = check_probes(frames, self._belief.sensors, time_s)
        else:
            _, sensors = self._get_pipeline().assess(frames, self._belief.sensors, time_s, self._find_state)
        self._belief = msgspec.structs.replace(self._belief, sensors=sensors)

    def _take(self) -> Environment | None:
        """The belief, when it is of this episode."""
        belief = self._belief
        if belief is not None and belief.episode != self._scene.episode:
            self._belief = belief = None
            self._states.clear()
        return belief

    def _get_pipeline(self) -> Pipeline:
        given = {name: each for name, each in self._belief.entities.items() if each.described} if self._belief else {}
        key = self._scene.name, *((name, each.shapes, each.rgb) for name, each in given.items())
        if key not in self._pipelines:
            if len(self._pipelines) >= MEMORY:
                self._pipelines.clear()
            inventory = build_inventory(read_placed(self._library, self._scene.name), self._prior, given)
            segmenter = DetectorSegmenter(self._detector, inventory) if self._detector is not None else None
            self._pipelines[key] = Pipeline(
                inventory, self._robot, self._target, self._max_age_s, segmenter, noisy=self._noisy
            )
        return self._pipelines[key]

    def _find_state(self, time_s: float) -> TargetState:
        """The target's state nearest to a moment."""
        if not self._states:
            raise ExecutionError("REQUEST_INVALID", "no state of the target has been read yet")
        nearest = min(self._states, key=lambda each: abs(each[0] - time_s))
        look = self._look
        if look is not None and nearest[0] <= look.now[0] and nearest not in look.states:
            look.states.append(nearest)
        return nearest[1]
