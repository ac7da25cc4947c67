"""The embedded pipeline as a function: frames, the robot's own state and the belief before give the belief after.

No learned weights: colour, form, geometry. Paper section 4.1.
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.settings.perception import Prior
from phyagentos.protocol.world.descriptions import name_described
from phyagentos.protocol.world.environment import Entity, Environment, SensorHealth, Status, TargetState
from phyagentos.runtime.perception.articulated import place_articulated
from phyagentos.runtime.perception.belief import find_changes, follow_hand, lose_sight, read_regions, update_belief
from phyagentos.runtime.perception.confirmation import confirm
from phyagentos.runtime.perception.grip import Hand
from phyagentos.runtime.perception.inventory import Inventory
from phyagentos.runtime.perception.robot_mask import RobotMask
from phyagentos.runtime.perception.segmentation import Colorless, Palette, Segmenter
from phyagentos.runtime.perception.sensor_health import (
    assess,
    find_disagreeing,
    find_displaced,
    has_moved_in_view,
    note_displaced,
)
from phyagentos.runtime.perception.supports import measure_supports, replace_surface
from phyagentos.runtime.perception.unknown_objects import find_unknown_objects, is_unknown_object
from phyagentos.runtime.perception.views import CameraView, drop_stray, find_cloud, make_view
from phyagentos.runtime.targets.wire import Frame, Frames

MAX_AGE_S = 0.3  # of a frame: its latency, and half a dozen lost ones


class Pipeline:
    """Senses one scene with one robot, whose solids are masked. It keeps no belief; its caller does.

    Frames older than `max_age_s` are ignored. Without a segmenter, pixels are labelled by colour. Pictures of `noisy`
    sensors never repeat.
    """

    def __init__(
        self,
        inventory: Inventory,
        robot: RobotMask,
        target: str,
        max_age_s: float = MAX_AGE_S,
        segmenter: Segmenter | None = None,
        *,
        noisy: bool = True,
    ) -> None:
        self.inventory, self._noisy = inventory, noisy
        self._robot, self._target, self._max_age_s = robot, target, max_age_s
        self._hand = Hand(target=target, reach_m=robot.reach_m, find_middle=robot.find_middle)
        colors = Palette(inventory.palette) if len(inventory.palette) > 1 else Colorless()
        self._segmenter: Segmenter = segmenter or colors
        self.can_confirm = segmenter is None  # a detector is made for whole pictures

    def sense(
        self,
        frames: Frames,
        state: TargetState,
        scene: Scene,
        time_s: float,
        before: Environment | None = None,
        *,
        focus: Collection[str] = (),
        find_state: Callable[[float], TargetState] | None = None,
    ) -> Environment:
        """The world after a look at `time_s`; a belief of another episode is ignored.

        The frames are windows of the objects in `focus`, or whole ones; `state` is the target's own now, `find_state`
        tells it at an earlier time [s].
        """
        known = before if before is not None and before.episode == scene.episode else None
        entities = dict(known.entities) if known is not None else {}
        earlier = known.sensors if known is not None and not focus else {}
        find_state = find_state or (lambda _time_s: state)
        believed, health = self.assess(frames, earlier, time_s, find_state)
        believed = tuple(map(drop_stray, believed))
        if not focus:
            believed, health = find_displaced(believed, earlier, health, self.inventory.place_map(entities).map, time_s)
        after, health = self._update(
            look=_Look(scene, state, time_s, entities, known, focus, find_state), believed=believed, health=health
        )
        sensors = health if not focus else (known.sensors if known is not None else {})
        looked_at_s = time_s if not focus else (known.looked_at_s if known is not None else 0.0)
        return Environment(
            time_s=time_s,
            scene=scene.name,
            episode=scene.episode,
            revision=(before.revision if before is not None else 0) + 1,
            sensing="perceived",
            entities=after,
            regions=read_regions(self.inventory, after),
            targets={self._target: self.own_state(state, after)},
            sensors=sensors,
            looked_at_s=looked_at_s,
            changes=find_changes(entities, after),
            never_seen=tuple(sorted({*self.inventory.find_unseen(after), *(scene.described.keys() - after.keys())})),
            prior=self.inventory.summarise(),
        )

    def _update(
        self, look: "_Look", believed: tuple[Frame, ...], health: dict[str, SensorHealth]
    ) -> tuple[dict[str, Entity], dict[str, SensorHealth]]:
        """The entities after a look, without the cameras that others contradict, and the health of every camera."""
        robots = tuple(self._robot.pose(look.find_state(each.time_s)) for each in believed)
        views = tuple(make_view(frame) for frame in believed)
        labels: tuple[NDArray[np.uint8], ...] = ()
        try:
            labels = tuple(self._segmenter.label(frame.rgb) for frame in believed)
        except ExecutionError as error:  # of a detector: what is not segmented is not seen
            blind = {"status": "unread", "detail": str(error)}
            health = {name: msgspec.structs.replace(each, **blind) for name, each in health.items()}
            believed = ()
        if not believed:
            felt = follow_hand(self.inventory, look.entities, look.state, self._hand, look.time_s)
            return self.inventory.place_map(felt).known | lose_sight(felt, look.focus), health
        inventory = self.inventory
        if inventory.prior is Prior.NONE:
            inventory = replace_surface(inventory, look.entities, believed, views)
        supports = {} if look.focus else measure_supports(believed, views, labels, inventory, look.entities)
        inventory = inventory.place_map(look.entities | supports)
        cloud = find_cloud(believed, views, labels, inventory, robots)
        views = tuple(_place_crop(view, look.known) for view in views) if look.focus else views
        after = update_belief(
            inventory,
            look.entities,
            views,
            cloud,
            look.state,
            hand=self._hand,
            time_s=max(frame.time_s for frame in believed),
            focus=look.focus,
        )
        if look.focus:
            return after, health
        if camera := find_disagreeing(self.inventory.objects, after, views, cloud):
            others = tuple(frame for frame in believed if frame.camera != camera)
            displaced = note_displaced(health, camera, "its depth disagrees with the other cameras", look.time_s)
            return self._update(look, others, displaced)
        named = {name: entity for name, entity in after.items() if not is_unknown_object(name)}
        after = named | find_unknown_objects(believed, views, robots, inventory.map, after)
        return name_described(after, look.scene.described), health

    def assess(
        self,
        frames: Frames,
        before: Mapping[str, SensorHealth],
        time_s: float,
        find_state: Callable[[float], TargetState],
    ) -> tuple[tuple[Frame, ...], dict[str, SensorHealth]]:
        """The frames of healthy cameras, and the health of every camera; `find_state` as of `sense`."""
        if self._noisy:
            return assess(frames, before, time_s, self._max_age_s)

        def would_differ(frame: Frame, was: SensorHealth) -> bool:
            return has_moved_in_view(frame, was, self._robot, find_state(frame.time_s))

        return assess(frames, before, time_s, self._max_age_s, would_differ, lambda each: find_state(each).q_rad)

    def confirm(
        self, frames: Frames, state: TargetState, time_s: float, before: Environment, names: Collection[str]
    ) -> Environment | None:
        """The world after a short look that shows these objects unmoved; None where uncertain.

        Frames are windows around them, thinned or not; `before` is the belief, carried on to now.
        """
        believed, _ = assess(frames, {}, time_s, self._max_age_s)
        pictures = [(frame, self._segmenter.label(frame.rgb)) for frame in believed]
        seen: dict[str, Entity] = {}
        for name in names:
            item, entity = self.inventory.objects[name], before.entities[name]
            for frame, labels in pictures:
                where = confirm(item, entity, frame, labels, before.sensors[frame.camera].focal_px)
                if where is not None:
                    seen[name] = msgspec.structs.replace(
                        entity, observed_at_s=frame.time_s, visible=True, evidence=(where,)
                    )
                    break
            else:
                return None
        after = place_articulated(self.inventory.articulated, before.entities | seen)
        return msgspec.structs.replace(
            before,
            time_s=time_s,
            revision=before.revision + 1,
            entities=after,
            targets={self._target: self.own_state(state, after)},
            changes=(),
        )

    def recall(self, before: Environment, state: TargetState, time_s: float) -> Environment:
        """The belief without a look: a held object has moved with the hand."""
        after = follow_hand(self.inventory, before.entities, state, self._hand, time_s)
        return msgspec.structs.replace(
            before, time_s=time_s, entities=after, targets={self._target: self.own_state(state, after)}
        )

    def own_state(self, state: TargetState, entities: dict[str, Entity]) -> TargetState:
        """The target's state with the perceived held objects: touch does not identify them."""
        held = tuple(sorted(name for name, entity in entities.items() if entity.status is Status.HELD))
        return msgspec.structs.replace(state, holding=held)


@dataclass(frozen=True, slots=True)
class _Look:
    """What a call of `sense` starts from; `known` is the belief before, of the same episode."""

    scene: Scene
    state: TargetState
    time_s: float
    entities: dict[str, Entity]
    known: Environment | None
    focus: Collection[str]
    find_state: Callable[[float], TargetState]


def _place_crop(view: CameraView, before: Environment | None) -> CameraView:
    """A view with its crop's origin in the whole picture, by the middle of the latest whole picture."""
    health = before.sensors.get(view.camera) if before is not None else None
    if health is None:
        return view
    return replace(
        view, origin_px=(round(health.focal_px[2] - view.focal[2]), round(health.focal_px[3] - view.focal[3]))
    )
