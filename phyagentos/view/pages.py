"""HTML of panels and pages: templates of this package, everything from documents escaped."""

from collections.abc import Callable
from functools import cache
from typing import Any

import msgspec

from phyagentos.errors import DefinitionError, ExecutionError, needs_extra
from phyagentos.protocol.documents.markdown import format_value
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.view.documents import Documents
from phyagentos.view.panels import Panel, Query
from phyagentos.view.quantities import format_measure, name_quantity

NOTHING = "<!---->"  # of a panel that has nothing to show
_KEPT = 256  # rendered panels


@cache
def get_templates() -> Any:
    """The environment of jinja2; raises DefinitionError `EXTRA_MISSING`."""
    with needs_extra("view", "the page"):
        from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
        from markupsafe import Markup
    made = Environment(
        loader=PackageLoader("phyagentos.view"), autoescape=select_autoescape(default=True), undefined=StrictUndefined
    )
    made.filters |= {
        "drawing": Markup,
        "number": format_value,
        "measure": format_measure,
        "quantity": name_quantity,
        "yaml": _render_yaml,
    }  # drawings and panels are escaped
    return made


def render(template: str, **values: Any) -> str:
    """One template, by its name without suffix."""
    return str(get_templates().get_template(f"{template}.html").render(values))


class PanelRenderer:
    """Renders panels, each once for all viewers with the same choice, until what it follows changes."""

    def __init__(self, documents: Documents, extras: Callable[[], Fields] = dict) -> None:
        self.documents, self._extras = documents, extras
        self._known: dict[tuple[Any, ...], str] = {}

    def render(self, panel: Panel, query: Query) -> str:
        """HTML of the inside of a panel; where its documents cannot be read, what is wrong with them."""
        status = self.documents.find_session(query.session, query.goal)
        own = (status.contract.id, status.updated_at) if status is not None else None
        version = (own if name == "session" else getattr(self.documents.version, name) for name in panel.follows)
        key = (panel.name, query, *version)
        if key not in self._known:
            self._known[key] = self._render(panel, query, status)
            for old in list(self._known)[:-_KEPT]:
                self._known.pop(old, None)
        return self._known[key]

    def _render(self, panel: Panel, query: Query, status: SessionStatus | None) -> str:
        names = {
            "w": self.documents.given,
            "id": status.contract.id if status is not None else "SESSION",
            "skill": status.contract.skill if status is not None else "TREE",
        }
        head = {"panel": panel, "file": panel.file.format(**names), "command": panel.command.format(**names)}
        try:
            values = panel.read(self.documents, query, status)
            if panel.empty and not values[panel.empty]:
                return NOTHING
            inside = render(panel.name, query=query, **self._extras(), **values)
        except (DefinitionError, ExecutionError, OSError, ValueError, LookupError, TypeError) as error:
            inside = render("unreadable", error=error)
        return render("panel", inside=inside, **head)


def _render_yaml(value: Any) -> str:
    return msgspec.yaml.encode(value).decode().strip()
