"""Camera frames as perceived: the whole pictures of a session's looks, and where in them objects were seen."""

from collections import defaultdict
from dataclasses import dataclass

from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.looks import (
    LookEntry,
    Pointer,
    StoredFrame,
    Window,
    iter_whole_frames,
    name_picture,
)


@dataclass(frozen=True, slots=True)
class SeenFrame:
    """A picture that perception has used; `seen` are the windows of objects in it, by name."""

    look: LookEntry
    frame: StoredFrame
    seen: dict[str, Window]


def read_frames(bundle: Bundle) -> list[SeenFrame]:
    """In the order of their looks; raises ExecutionError `EVIDENCE_DAMAGED`."""
    windows: dict[str, dict[str, Window]] = defaultdict(dict)
    for world in (bundle.before, bundle.after):
        for entity in world.entities.values() if world is not None else ():
            for pointer in Pointer.parse_all(entity.evidence):
                windows[pointer.picture][entity.name] = pointer.window
    return [
        SeenFrame(look, frame, windows[name_picture(frame.camera, frame.time_s)])
        for look, frame in iter_whole_frames(bundle.folder)
    ]
