"""The panels of the page: for each what it shows, the file that this stands in, and the command that prints it."""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import urlencode

from phyagentos.agent.tools.proposals import WAITING_MAX, Proposals
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.operations.answer import iter_open
from phyagentos.pictures.goals import Drawn, draw_goal
from phyagentos.pictures.statechart import draw_statechart
from phyagentos.pictures.trees import draw_tree, tick
from phyagentos.protocol.capabilities.trees import read_tree
from phyagentos.protocol.documents.document import read_document
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.regular_files import open_regular, read_regular
from phyagentos.protocol.sessions.estop import read_latch
from phyagentos.protocol.sessions.evidence import MOTION, PICTURE_AFTER, SCENE_MODEL, TRAJECTORY
from phyagentos.protocol.sessions.knowledge import KNOWLEDGE
from phyagentos.protocol.sessions.lessons import LESSONS
from phyagentos.protocol.sessions.session import SessionId, SessionStatus
from phyagentos.protocol.sessions.tasks import GoalStatus, Step
from phyagentos.protocol.settings.safety import get_target_limits, read_safety
from phyagentos.protocol.workspace.array_files import read_arrays
from phyagentos.store.views.tasks import describe_fault
from phyagentos.view.comparison import list_moved
from phyagentos.view.documents import BUNDLES_KEPT, Documents
from phyagentos.view.frames import read_frames
from phyagentos.view.plots import draw_map, draw_plots
from phyagentos.view.story import Picture, find_decisive, find_pictures, list_moments, list_phases
from phyagentos.view.timeline import measure_length, read_timeline

if TYPE_CHECKING:
    from phyagentos.view.distance import Distance
    from phyagentos.view.judged import JudgedPicture

SESSIONS_SHOWN, LINES_SHOWN, FRAMES_SHOWN, GOALS_SHOWN = 60, 40, 12, 20
LINE_SHOWN = 2000  # letters of a line
END_BYTES, PROPOSALS_BYTES = 1 << 16, 1 << 20  # read of a log; of proposals that are shown with a form
Session = SessionStatus | None  # that a viewer has chosen, or that runs
_EVENT = re.compile(r"- \d\d:")  # a line of LOG.md that is no explanation


@dataclass(frozen=True, slots=True, kw_only=True)
class Query:
    """What a viewer has chosen; empty follows the latest goal, and the session that runs.

    Attributes:
        find: Words that shown steps and sessions hold.
    """

    goal: str = ""
    session: str = ""
    find: str = ""

    def show(self, picture: Picture) -> str:
        """Address of a picture."""
        return picture.address

    def link(self, **changed: str) -> str:
        """Address of the page with another choice."""
        chosen = {"goal": self.goal, "session": self.session, "find": self.find} | changed
        return "./?" + urlencode({name: value for name, value in chosen.items() if value})


class Place(StrEnum):
    """Where a panel stands on a wide page."""

    TOP = "top"
    LEFT = "left"
    RIGHT = "right"


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One panel.

    Attributes:
        name: Also of its template.
        file: What it is read from, relative to the workspace; `{id}` is the session.
        command: What prints the same; `{id}` likewise, and `{w}` the workspace.
        read: The values of its template.
        follows: Parts of `Version` with which it changes; `session` is the latest record of the session that it shows.
        place: Where it stands on a wide page.
        empty: A value of its template without which there is nothing to show; such a panel is absent.
    """

    name: str
    title: str
    file: str
    command: str
    read: Callable[[Documents, Query, Session], Fields]
    follows: tuple[str, ...] = ("journal",)
    place: Place = Place.LEFT
    empty: str = ""


def _choose_goal(documents: Documents, query: Query, status: Session) -> GoalStatus | None:
    """That of the address, else that of the session, else the latest."""
    of_session = status.contract.goal if status is not None else ""
    return documents.find_goal(query.goal or of_session) or documents.find_goal(query.goal)


def _read_headline(documents: Documents, query: Query, status: Session) -> Fields:
    goal = _choose_goal(documents, query, status)
    others = list(documents.ledger.goals)[-GOALS_SHOWN:]
    if goal is None:
        return {"goal": None, "goals": others, "w": documents.given}
    sessions = [each for node in goal.nodes.values() for each in node.sessions]
    replans = [each for node in goal.nodes.values() for each in node.replans]
    _, wall_s = measure_length(documents, goal)
    asks = any(not each.is_decided for each in iter_open(documents.workspace, documents.ledger, goal.id))
    state = goal.verdict or ("cancelled" if goal.is_cancelled else "running" if documents.is_running() else "open")
    return {
        "goal": goal, "goals": others, "sessions": sessions, "replans": replans, "wall_s": wall_s,
        "state": state, "waits": asks and not (goal.verdict or goal.is_cancelled),
    }  # fmt: skip


def _read_timeline(documents: Documents, query: Query, status: Session) -> Fields:
    goal = _choose_goal(documents, query, status)
    chosen = status.contract.id if status is not None else ""
    timeline = read_timeline(documents, goal, chosen) if goal is not None else None
    is_there = timeline is not None and (timeline.lanes or timeline.waiting)
    return {"timeline": timeline if is_there else None, "status": status}


def _read_goal(documents: Documents, query: Query, status: Session) -> Fields:
    goal = _choose_goal(documents, query, status)
    if goal is None or not goal.nodes:
        return {"goal": None}

    def show(step: Step) -> Drawn:
        if not step.session:
            return Drawn()
        execution = documents.ledger.sessions[SessionId(step.session)].execution
        after = Picture("after", documents.workspace.evidence_of(SessionId(step.session)), PICTURE_AFTER)
        picture = query.show(after) if (after.folder / after.file).is_file() else ""
        return Drawn(query.link(session=step.session), picture, execution.sim_time_s if execution else None)

    svg = draw_goal(goal, find=query.find, show=show)
    every = [each for node in goal.nodes.values() for each in node.replans]
    replans = [(each, describe_fault(each, documents.ledger)) for each in every]
    return {"goal": goal, "svg": svg, "replans": replans}


def _read_sessions(documents: Documents, query: Query, status: Session) -> Fields:
    goal, wanted = _choose_goal(documents, query, status), query.find.casefold()
    every = [each for each in documents.ledger.sessions.values() if goal is None or each.contract.goal == goal.id]
    words = ((each, f"{each.contract.id} {each.state} {each.contract.skill}".casefold()) for each in reversed(every))
    found = [each for each, text in words if wanted in text]
    return {"sessions": found[:SESSIONS_SHOWN], "found": len(found), "all": len(every)}


def _read_statechart(documents: Documents, _: Query, status: Session) -> Fields:
    visited = [each.state for each in documents.passages[status.contract.id]] if status is not None else []
    return {"status": status, "visited": visited, "svg": draw_statechart(visited)}


def _read_tree(documents: Documents, _: Query, status: Session) -> Fields:
    if status is None:
        return {"has_run": False}
    trace, beat = documents.read_bundle(status).trace, documents.find_beat(status)
    root = next((event.path.partition("/")[0] for event in trace), status.contract.skill)
    library = documents.workspace.library()
    try:
        drawing = draw_tree(read_tree(library.get_tree(root)), library)
    except DefinitionError:  # a policy, or an agent that chooses its tools
        return {"has_run": bool(trace), "root": None, "loose": trace[-LINES_SHOWN:], "beat": beat}
    return {"has_run": bool(trace), "root": tick(drawing, trace), "loose": [], "beat": beat}


def _read_story(documents: Documents, _: Query, status: Session) -> Fields:
    if status is None:
        return {"status": None}
    sessions, beat = documents.ledger.sessions, documents.find_beat(status)
    story: Fields = {
        "status": status,
        "parent": sessions.get(status.contract.parent) if status.contract.parent else None,
        "children": [each for each in sessions.values() if each.contract.parent == status.contract.id],
        "leaf": beat.leaf if beat is not None else "",
        "decisive": find_decisive(status.decision),
        "judged": None,
        "phases": [],
        "pictures": [],
        "moved": [],
        "problem": "",
    }
    try:
        bundle = documents.read_bundle(status)
        story["phases"], story["pictures"] = list_phases(bundle.trace), find_pictures(bundle.folder)
        story["moved"] = list_moved(documents, status)
        story["judged"] = _read_judged(documents, status.contract.id, status.updated_at)[0]
    except ExecutionError as error:
        story["problem"] = str(error)
    return story


@lru_cache(maxsize=BUNDLES_KEPT)
def _read_judged(documents: Documents, id: SessionId, _: str) -> "tuple[JudgedPicture | None, Distance | None]":
    """The number that decided in a picture and over time, as of one update of its session."""
    from phyagentos.pictures.playback import read_playback
    from phyagentos.view.distance import read_distance
    from phyagentos.view.judged import find_judged

    status = documents.ledger.sessions[id]
    bundle, decisive = documents.read_bundle(status), find_decisive(status.decision)
    if decisive is None:
        return None, None
    playback = read_playback(documents.workspace, status) if (bundle.folder / MOTION).is_file() else None
    return find_judged(bundle, decisive, playback), read_distance(bundle, decisive, playback)


def _read_distance(documents: Documents, _: Query, status: Session) -> Fields:
    return {"distance": _read_judged(documents, status.contract.id, status.updated_at)[1] if status else None}


def _read_motion(documents: Documents, _: Query, status: Session) -> Fields:
    path = documents.workspace.evidence_of(status.contract.id) / TRAJECTORY if status is not None else None
    if status is None or path is None or not path.is_file():
        return {"plots": []}
    file = documents.workspace.safety
    limits = get_target_limits(read_safety(file), status.contract.target, file.name)
    return {"plots": draw_plots(read_arrays(path), limits), "status": status}


def _read_map(documents: Documents, _: Query, status: Session) -> Fields:
    path = documents.workspace.evidence_of(status.contract.id) / TRAJECTORY if status is not None else None
    if path is None or not path.is_file() or (world := documents.read_world(status)) is None:
        return {"map": None}
    return {"map": draw_map(read_arrays(path), world)}


def _read_world(documents: Documents, _: Query, status: Session) -> Fields:
    try:
        world = documents.read_world(status) or documents.read_world(None)
    except DefinitionError as error:
        if error.problems[0].code != "NOT_OBSERVED":
            raise
        world = None
    return {"world": world, "entities": list(world.entities.values()) if world is not None else []}


def _read_frames(documents: Documents, _: Query, status: Session) -> Fields:
    return {"status": status, "frames": read_frames(documents.read_bundle(status))[:FRAMES_SHOWN] if status else []}


def _read_scene(documents: Documents, _: Query, status: Session) -> Fields:
    if status is None or not (documents.workspace.evidence_of(status.contract.id) / SCENE_MODEL).is_file():
        return {"status": None}
    bundle = documents.read_bundle(status)
    times = {"before": bundle.before, "after": bundle.after}
    shown = find_pictures(bundle.folder)
    at = [(each, world.time_s if (world := times[each.label]) is not None else 0.0) for each in shown]
    return {"status": status, "pictures": at, "moments": list_moments(bundle, status.execution)}


def _read_guard(documents: Documents, _: Query, status: Session) -> Fields:
    return {"status": status, "events": documents.read_bundle(status).interventions if status is not None else []}


def _read_log(documents: Documents, _: Query, __: Session) -> Fields:
    events = [line for line in _read_end(documents.workspace.log) if _EVENT.match(line)]
    logs = {path.stem: _read_end(path)[-LINES_SHOWN:] for path in sorted(documents.workspace.logs.glob("*.log"))}
    logs = {name: lines for name, lines in logs.items() if lines}
    return {"events": events[-LINES_SHOWN:], "logs": logs, "has_lines": bool(events or logs)}


def _read_end(path: Path) -> list[str]:
    """The last lines of a log; none of what is no regular file."""
    try:
        fd, found = open_regular(path, follow=False)
    except OSError:
        return []
    with os.fdopen(fd, "rb") as file:
        file.seek(max(0, found.st_size - END_BYTES))
        return [line[:LINE_SHOWN] for line in file.read(END_BYTES).decode(errors="replace").splitlines()]


def _read_memory(documents: Documents, _: Query, __: Session) -> Fields:
    place = documents.workspace
    lessons = read_document(read_regular(place.lessons).decode(), LESSONS, place.lessons.name).blocks
    facts = read_document(read_regular(place.knowledge).decode(), KNOWLEDGE, place.knowledge.name).blocks
    return {"entries": [*lessons.values(), *facts.values()]}


def _read_runtime(documents: Documents, _: Query, __: Session) -> Fields:
    place = documents.workspace
    stages = documents.list_stages()
    beats = documents.read_beats().values() if stages["runtime"] else ()
    goal = documents.find_goal()
    ended = [each for each in documents.ledger.sessions.values() if goal and each.contract.goal == goal.id]
    is_open = goal is None or not (goal.verdict or goal.is_cancelled or any(each.execution for each in ended))
    waits = stages["command"] and is_open and not stages["motion"]
    proposed = len(Proposals(place.proposals).list_waiting())
    seen = {"latch": read_latch(place.signals.parent), "beats": list(beats), "proposed": proposed}
    return {"stages": stages, "begins": waits, **seen}


def _read_proposals(documents: Documents, _: Query, __: Session) -> Fields:
    """By their own bytes, as their names stand for them; what cannot be read hides no other."""
    proposals, shown, left = Proposals(documents.workspace.proposals), [], PROPOSALS_BYTES
    waiting = proposals.list_waiting()
    for name in waiting[:WAITING_MAX]:
        try:
            proposed = proposals.read(name)
        except DefinitionError as error:
            shown.append({"name": name, "text": "", "sha256": "", "problem": str(error)[:LINE_SHOWN]})
            continue
        fits = len(proposed.data) <= max(left, PROPOSALS_BYTES // WAITING_MAX)  # a small one has room in any case
        left -= len(proposed.data)
        problem = "" if fits else f"{len(proposed.data)} bytes: read it by `paos approve {name}`."
        text = proposed.data.decode() if fits else ""
        shown.append({"name": name, "text": text, "sha256": proposed.sha256, "problem": problem})
    strange = [
        path.name for path in sorted(documents.workspace.proposals.glob("new/*")) if not proposals.has(path.stem)
    ]
    shown += [
        {"name": name, "text": "", "sha256": "", "problem": "This is no proposal."} for name in strange[:WAITING_MAX]
    ]
    return {"proposals": shown, "more": sum(max(0, len(each) - WAITING_MAX) for each in (waiting, strange))}


def _read_questions(documents: Documents, _: Query, __: Session) -> Fields:
    """Those of criteria that a person decides; each by its place among those of its session or goal, from 1."""
    waiting = list(iter_open(documents.workspace, documents.ledger))
    numbers = [1 + sum(each.subject == before.subject for before in waiting[:at]) for at, each in enumerate(waiting)]
    pictures = [find_pictures(Path(each.pictures[0]).parent) if each.pictures else [] for each in waiting]
    return {"questions": list(zip(waiting, numbers, pictures, strict=True))}


_JOURNAL, _BEATS, _TRACES, _FILES, _STAGE = "journal", "beats", "traces", "files", "stage"
_OWN = ("session",)
_LIVE = (_JOURNAL, _TRACES)  # what moves in between comes with the heartbeats
PANELS = (
    Panel(name="headline", title="Run", file="TASK.md", command="paos graph -w {w}", read=_read_headline,
          follows=(_JOURNAL, _BEATS, _FILES, _STAGE), place=Place.TOP),
    Panel(name="runtime", title="Now", file="heartbeats/", command="paos status -w {w}", read=_read_runtime,
          follows=(_JOURNAL, _BEATS, _FILES, _STAGE), place=Place.TOP),
    Panel(name="questions", title="Questions to you", file="evidence/{id}/", command="paos answer {id} yes -w {w}",
          read=_read_questions, follows=(_JOURNAL, _BEATS, _FILES), place=Place.TOP, empty="questions"),
    Panel(name="timeline", title="Timeline", file="sessions/", command="paos graph -w {w}", read=_read_timeline,
          follows=(_JOURNAL, _BEATS), place=Place.TOP, empty="timeline"),
    Panel(name="story", title="Session", file="SESSIONS.md", command="paos why {id} -w {w}", read=_read_story,
          follows=_LIVE, place=Place.TOP, empty="status"),
    Panel(name="scene", title="Scene", file="evidence/{id}/motion.npz", command="paos render {id} -w {w}",
          read=_read_scene, follows=_LIVE, empty="status"),
    Panel(name="distance", title="Distance to the criterion", file="evidence/{id}/motion.npz",
          command="paos why {id} -w {w}", read=_read_distance, follows=_OWN, empty="distance"),
    Panel(name="motion", title="Motion", file="evidence/{id}/trajectory.npz", command="paos render {id} -w {w}",
          read=_read_motion, follows=_OWN, empty="plots"),
    Panel(name="map", title="Map", file="evidence/{id}/trajectory.npz", command="paos why {id} -w {w}", read=_read_map,
          follows=_OWN, empty="map"),
    Panel(name="frames", title="Camera frames", file="evidence/{id}/looks.json",
          command="paos verify {id} -w {w} --from-frames", read=_read_frames, empty="frames"),
    Panel(name="world", title="Objects", file="evidence/{id}/environment_after.json",
          command="paos context -w {w}", read=_read_world, follows=(_JOURNAL, _FILES), empty="world"),
    Panel(name="statechart", title="Statechart", file="sessions/", command="paos lifecycle", read=_read_statechart,
          follows=_OWN, empty="status"),
    Panel(name="tree", title="Behaviour tree", file="evidence/{id}/trace.jsonl", command="paos tree show {skill}",
          read=_read_tree, follows=(*_OWN, _TRACES), place=Place.RIGHT, empty="has_run"),
    Panel(name="guard", title="Guard", file="evidence/{id}/events.jsonl", command="paos why {id} -w {w}",
          read=_read_guard, follows=_OWN, place=Place.RIGHT, empty="events"),
    Panel(name="goal", title="Goal", file="TASK.md", command="paos graph -w {w}", read=_read_goal, place=Place.RIGHT,
          empty="goal"),
    Panel(name="sessions", title="Sessions", file="SESSIONS.md", command="paos graph -w {w}", read=_read_sessions,
          place=Place.RIGHT, empty="all"),
    Panel(name="proposals", title="Proposals", file="proposals/new/", command="paos approve -w {w}",
          read=_read_proposals, follows=(_FILES,), place=Place.RIGHT, empty="proposals"),
    Panel(name="memory", title="Memory", file="LESSONS.md", command="paos memory show --all -w {w}", read=_read_memory,
          follows=(_FILES,), place=Place.RIGHT, empty="entries"),
    Panel(name="log", title="Log", file="LOG.md", command="paos logs -w {w}", read=_read_log,
          follows=(_JOURNAL, _FILES), place=Place.RIGHT, empty="has_lines"),
)  # fmt: skip
