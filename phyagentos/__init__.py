"""phyagentos: robots run on sessions that are verified, not merely finished.

The package has two planes that meet only in documents: `phyagentos.agent` decides what should be done and judges what
was done; `phyagentos.runtime` decides how it is carried out. Their shared vocabulary is `phyagentos.protocol`.
Scripts and notebooks use the names of `phyagentos.api`, which is loaded with the first of them.
"""

from typing import TYPE_CHECKING

__version__ = "0.1.0"
__all__ = [
    "Figure",
    "GoalView",
    "SessionView",
    "WorkspaceView",
    "ask",
    "compare",
    "compile",
    "lint",
    "open_runs",
    "open_workspace",
    "plan",
    "run",
    "run_many",
    "run_many_async",
    "status",
    "why",
]

if TYPE_CHECKING:  # a type checker sees these names, and no others
    from phyagentos.api import (
        Figure,
        GoalView,
        SessionView,
        WorkspaceView,
        ask,
        compare,
        compile,
        lint,
        open_runs,
        open_workspace,
        plan,
        run,
        run_many,
        run_many_async,
        status,
        why,
    )
else:

    def __getattr__(name: str) -> object:
        if name not in __all__:
            raise AttributeError(f"module 'phyagentos' has no attribute {name!r}")
        from phyagentos import api

        return getattr(api, name)

    def __dir__() -> list[str]:
        return [*globals(), *__all__]
