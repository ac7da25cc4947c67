"""One goal as one HTML file that opens without a server: graph, sessions, statecharts, trees, pictures, verdicts."""

from base64 import b64encode
from pathlib import Path

from typing_extensions import override

from phyagentos.errors import DefinitionError
from phyagentos.operations.export import Written
from phyagentos.protocol.sessions.evidence import PICTURE_AFTER, PICTURE_BEFORE
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.view.documents import Documents
from phyagentos.view.pages import PanelRenderer, render
from phyagentos.view.panels import PANELS, Panel, Query

_OVERVIEW, _OF_SESSION = ("goal", "sessions", "memory", "log"), ("verdict", "tree", "statechart", "world", "guard")


class AnchoredQuery(Query):
    """Links lead to the same file."""

    @override
    def link(self, **changed: str) -> str:
        return f"#session-{changed['session']}" if changed.get("session") else "#"


def build_archive(documents: Documents, goal: GoalStatus) -> str:
    """The HTML of a goal, as its documents stand; raises DefinitionError `EXTRA_MISSING`."""
    renderer = PanelRenderer(documents, lambda: {"actions": False, "live": False})
    by_name = {panel.name: panel for panel in PANELS}
    return render(
        "archive",
        goal=goal,
        css=Path(__file__).with_name("static").joinpath("page.css").read_text(encoding="utf-8"),
        overview=[renderer.render(by_name[name], AnchoredQuery(goal=goal.id)) for name in _OVERVIEW],
        sessions=[
            (
                status,
                [(by_name[name].title, _render_of(renderer, by_name[name], goal, id)) for name in _OF_SESSION],
                _read_pictures(documents.workspace.evidence_of(status.contract.id)),
            )
            for id, status in documents.ledger.sessions.items()
            if status.contract.goal == goal.id
        ],
    )


def write_archive(root: Path, goal: str, to: Path) -> Written:
    """Write a goal of a workspace, the latest without a name, as one file; raises DefinitionError `UNKNOWN_NAME`."""
    documents = Documents(root)
    documents.refresh()
    status = documents.find_goal(goal)
    if status is None:
        raise DefinitionError.unknown("goal", str(root), goal, documents.ledger.goals)
    to.write_text(build_archive(documents, status), encoding="utf-8")
    return Written(file=to)


def _render_of(renderer: PanelRenderer, panel: Panel, goal: GoalStatus, session: str) -> str:
    return renderer.render(panel, AnchoredQuery(goal=goal.id, session=session))


def _read_pictures(folder: Path) -> list[tuple[str, str]]:
    """Name and base64 of the pictures for people."""
    found = [path for name in (PICTURE_BEFORE, PICTURE_AFTER) if (path := folder / name).is_file()]
    return [(path.stem, b64encode(path.read_bytes()).decode()) for path in found]
