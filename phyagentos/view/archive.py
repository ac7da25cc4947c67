"""One goal as one HTML file that opens without a server: graph, sessions, statecharts, trees, pictures, verdicts."""

from base64 import b64encode
from pathlib import Path

from typing_extensions import override

from phyagentos.errors import DefinitionError
from phyagentos.operations.export import Written
from phyagentos.protocol.documents.regular_files import read_regular
from phyagentos.protocol.sessions.looks import read_picture
from phyagentos.protocol.sessions.tasks import GoalStatus
from phyagentos.view.documents import Documents
from phyagentos.view.pages import NOTHING, PanelRenderer, render
from phyagentos.view.panels import PANELS, Query
from phyagentos.view.story import Picture

_OVERVIEW, _OF_SESSION = (
    ("headline", "timeline", "goal", "memory", "log"),
    ("story", "distance", "motion", "tree", "world", "guard"),
)


class AnchoredQuery(Query):
    """Links lead to the same file, and pictures stand in it."""

    @override
    def show(self, picture: Picture) -> str:
        path = picture.folder / picture.file
        data = read_picture(path, picture.member) if picture.member else read_regular(path)
        return f"data:image/png;base64,{b64encode(data).decode()}"

    @override
    def link(self, **changed: str) -> str:
        return f"#session-{changed['session']}" if changed.get("session") else "#"


def build_archive(documents: Documents, goal: GoalStatus) -> str:
    """The HTML of a goal, as its documents stand; raises DefinitionError `EXTRA_MISSING`."""
    renderer = PanelRenderer(documents, lambda: {"actions": False, "live": False})
    by_name = {panel.name: panel for panel in PANELS}

    def show(names: tuple[str, ...], session: str = "") -> list[tuple[str, str]]:
        shown = [(name, renderer.render(by_name[name], AnchoredQuery(goal=goal.id, session=session))) for name in names]
        return [(name, inside) for name, inside in shown if inside != NOTHING]

    return render(
        "archive",
        goal=goal,
        css=Path(__file__).with_name("static").joinpath("page.css").read_text(encoding="utf-8"),
        overview=show(_OVERVIEW),
        sessions=[
            (id, show(_OF_SESSION, id))
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
