"""The story of one session: its objective, what it did, what was seen, and what decided the verdict."""

import contextlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.evidence import MOTION, PICTURE_AFTER, PICTURE_BEFORE, Bundle
from phyagentos.protocol.sessions.looks import LookRole, iter_whole_frames
from phyagentos.protocol.sessions.session import Execution
from phyagentos.protocol.sessions.trace import TraceEvent
from phyagentos.protocol.sessions.verdicts import Attempt, Criterion
from phyagentos.protocol.world.truth import Truth

MOMENTS = 25  # of a film of still pictures
_SHOWN = {LookRole.START: "before", LookRole.END: "after"}


@dataclass(frozen=True, slots=True)
class Phase:
    """A part of the tree directly below its root, or a policy: its status, and when it was active [s, simulated]."""

    name: str
    status: str
    code: str
    from_s: float
    to_s: float


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture of the world `before` or `after`: a file of the evidence, or a member of one.

    Attributes:
        folder: Of the evidence.
        member: Of a look's file; empty for a picture that was drawn for people.
    """

    label: str
    folder: Path
    file: str
    member: str = ""

    @property
    def address(self) -> str:
        """Relative to the page."""
        parts = (self.folder.name, self.file, self.member) if self.member else (self.folder.name, self.file)
        return "/".join(("frames" if self.member else "evidence", *(quote(each, safe="") for each in parts)))


def list_phases(trace: Iterable[TraceEvent]) -> list[Phase]:
    """In the order in which they began."""
    found: dict[str, Phase] = {}
    for event in trace:
        _, *below = event.path.split("/", 2)
        if not below or event.status == "INVALID":
            continue
        known = found.get(below[0], Phase(below[0], "", "", event.time_s, event.time_s))
        status, code = (known.status, known.code) if below[1:] else (event.status, event.code)
        found[below[0]] = replace(known, to_s=event.time_s, status=status, code=code)
    return list(found.values())


def find_pictures(folder: Path) -> list[Picture]:
    """Before and after: drawn ones, else those of the first camera."""
    drawn = [Picture(Path(name).stem, folder, name) for name in (PICTURE_BEFORE, PICTURE_AFTER)]
    if found := [each for each in drawn if (folder / each.file).is_file()]:
        return found
    seen: dict[str, Picture] = {}
    with contextlib.suppress(ExecutionError):  # the panel of the frames says what is wrong
        for look, frame in iter_whole_frames(folder):
            if label := _SHOWN.get(look.role):
                seen.setdefault(label, Picture(label, folder, look.file, frame.rgb))
    return list(seen.values())


def find_decisive(attempt: Attempt | None) -> Criterion | None:
    """The criterion that decided: the first that is false, else unknown, else true."""
    criteria = attempt.criteria if attempt is not None else ()
    order = (Truth.FALSE, Truth.UNKNOWN, Truth.TRUE)
    return min(criteria, key=lambda each: order.index(each.truth), default=None)


def list_moments(bundle: Bundle, execution: Execution | None) -> list[float]:
    """Simulated times of a film of still pictures, evenly over a session [s]; empty where no motion was kept."""
    if execution is None or bundle.before is None or not (bundle.folder / MOTION).is_file():
        return []
    return [bundle.before.time_s + execution.sim_time_s * index / (MOMENTS - 1) for index in range(MOMENTS)]
