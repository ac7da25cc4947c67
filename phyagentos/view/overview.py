"""The list with which a page of several runs begins: what runs first, then what was written last."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from urllib.parse import quote

from phyagentos.clock import SystemClock, compute_seconds
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.ledger import Ledger
from phyagentos.view.documents import find_latest
from phyagentos.view.places import Place, find_places
from phyagentos.view.story import find_pictures
from phyagentos.view.suites import Standing, read_grid

PAGE = 60  # places whose journals are read for one answer
GOALS_MAX = 20  # of one workspace, the latest
PICTURES_TRIED = 3  # sessions of a goal, the latest, in which a picture is looked for
_WRITTEN = ("LOG.md", "TASK.md", "episodes.jsonl")  # what grows while something happens


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A goal of a workspace, a workspace without one, or the run of a suite.

    Attributes:
        link: Address of its page, relative to the list, and of its `picture`.
        state: Verdict; `running`, `open` or `cancelled` without one.
        counts: Of a suite: episodes by how they stand.
        suite: Values of its grid.
        problem: Why it cannot be read.
    """

    place: Place
    link: str
    state: str = ""
    goal: GoalStatus | None = None
    wall_s: float = 0.0
    picture: str = ""
    counts: Counter[Standing] | None = None
    suite: Fields | None = None
    problem: str = ""


def read_overview(given: Sequence[Path], page: int) -> Fields:
    """Values of the template `overview`; `page` counts from 1."""
    written = {each: find_latest([each.root / name for name in _WRITTEN]) for each in find_places(given).values()}
    running = {each: each.is_running for each in written}
    places = sorted(written, key=lambda each: (running[each], written[each]), reverse=True)
    shown = places[PAGE * (page - 1) : PAGE * page]
    rows = [row for place in shown for row in _list_rows(place, is_running=running[place])]
    rows.sort(key=lambda row: row.state != "running")
    return {"rows": rows, "places": len(places), "page": page, "pages": max(1, -(-len(places) // PAGE))}


def _list_rows(place: Place, *, is_running: bool) -> list[Row]:
    link = f"{'suites' if place.is_suite else 'w'}/{place.key}/"
    try:
        if place.is_suite:
            grid = read_grid(place)
            state = "running" if is_running else "open" if grid["counts"][Standing.WAITING] else ""
            return [Row(place=place, link=link, state=state, counts=grid["counts"], suite=grid)]
        written = tuple(find_latest([path]) for path in sorted(place.root.glob("sessions/*/*")))
        workspace, ledger = _read_workspace(place.root, written)
        goals = [*reversed(ledger.goals.values())][:GOALS_MAX]
        rows = [_show_goal(place, workspace, ledger, goal, is_up=is_running and goal is goals[0]) for goal in goals]
        return rows or [Row(place=place, link=link)]
    except (DefinitionError, ExecutionError, OSError, ValueError, LookupError, TypeError) as error:
        return [Row(place=place, link=link, problem=str(error))]


@lru_cache(maxsize=512)
def _read_workspace(root: Path, _: tuple[int, ...]) -> tuple[Workspace, Ledger]:
    return Workspace.open(root), read_ledger(root)


def _show_goal(place: Place, workspace: Workspace, ledger: Ledger, goal: GoalStatus, *, is_up: bool) -> Row:
    ids = [each.contract.id for each in ledger.sessions.values() if each.contract.goal == goal.id]
    tried = (find_pictures(workspace.evidence_of(id)) for id in ids[: -PICTURES_TRIED - 1 : -1])
    pictures = next(filter(None, tried), [])
    state = goal.verdict or ("cancelled" if goal.is_cancelled else "running" if is_up else "open")
    until = SystemClock().wall_iso() if state == "running" else goal.updated_at
    return Row(
        place=place,
        link=f"w/{place.key}/?goal={quote(goal.id)}",
        state=state,
        goal=goal,
        wall_s=compute_seconds(goal.submitted_at, until) if goal.submitted_at else 0.0,
        picture=f"w/{place.key}/{pictures[-1].address}" if pictures else "",
    )
