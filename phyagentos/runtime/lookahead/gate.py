"""The last gate of preflight: a session with a look-ahead starts only when its chance of success is great enough.

The result stands in the session's evidence as `lookahead.json`, also when the session was refused and left nothing
else.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from phyagentos.errors import ExecutionError, Problem
from phyagentos.protocol.sessions.evidence import write_json
from phyagentos.protocol.sessions.lookahead import LOOKAHEAD, LookaheadResult
from phyagentos.protocol.sessions.session import Session
from phyagentos.runtime.lookahead.forecaster import LOOKAHEAD_FAILED, Case
from phyagentos.runtime.lookahead.service import RehearsalProcess
from phyagentos.runtime.perception.world_model import WORLD, WorldModel

LOOKAHEAD_LOW = "LOOKAHEAD_LOW"


class LookaheadGate:
    """Requests a forecast from the estimate of the world, and refuses by it."""

    def __init__(self, *, forecasts: RehearsalProcess, world: WorldModel, evidence: Path) -> None:
        self._forecasts, self._world = forecasts, world
        self._evidence = evidence
        self._result: LookaheadResult | None = None

    def find_problems(self, session: Session, tree: str, should_stop: Callable[[], bool]) -> Sequence[Problem]:
        """Why a session must not start; nothing when it requires no look-ahead.

        `tree` is that of its plan, empty for a policy; `should_stop` is called several times a second.
        """
        self._result = None
        if session.lookahead is None:
            return ()
        address = f"{session.id}: look-ahead"
        try:
            self._world.enter(session.scene)
            question = Case(
                session=session, request=session.lookahead, tree=tree, environment=self._world.observe(WORLD)
            )
            result = self._forecasts.ask(question, should_stop)
        except ExecutionError as error:
            return (Problem(error.code, address, str(error)),)
        if result is None:
            return (Problem(LOOKAHEAD_FAILED, address, "a stop was requested"),)
        self._result = result
        if not result.is_low:
            return ()
        self.file_result(self._evidence / session.id, new=True)
        return (_explain(result, address),)

    def file_result(self, folder: Path, *, new: bool = False) -> None:
        """Write the latest forecast into the folder of a bundle, if there was one; a `new` folder may be missing."""
        if self._result is None:
            return
        if new:
            folder.mkdir(parents=True, exist_ok=True)
        if folder.is_dir():
            write_json(folder / LOOKAHEAD, self._result)

    def close(self) -> None:
        """Close the forecasts."""
        self._forecasts.close()


def _explain(result: LookaheadResult, address: str) -> Problem:
    causes = ", ".join(f"{cause} {count:.4g}" for cause, count in sorted(result.causes.items(), key=lambda c: -c[1]))
    best = max(result.alternatives, key=lambda each: each.share, default=None)
    better = best is not None and best.share > result.share
    return Problem(
        LOOKAHEAD_LOW,
        address,
        found=f"{result.succeeded:.4g} of {result.samples} {result.cases} succeed ({causes})",
        expected=f"at least {result.threshold:g} of them",
        hint=f"{best.succeeded:.4g} of {best.samples} succeed {best.strategy}." if best is not None and better else "",
    )
