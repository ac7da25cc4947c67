"""Look-ahead: the agent asks what a session is likely to lead to, the runtime simulates it. Paper section 4.2.

The answer is `lookahead.json` of the evidence bundle. The request carries every seed, so it can be computed again.
"""

from pathlib import Path

import msgspec

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.strategy import Strategy

LOOKAHEAD = "lookahead.json"  # LookaheadResult; absent when none was requested


class LookaheadRequest(msgspec.Struct, frozen=True, kw_only=True):
    """Simulations that the agent asks for before a session is committed.

    Attributes:
        samples: Rollouts at most, each with its own drawn poses and parameters; clear cases take fewer.
        threshold: Least share of successful rollouts with which the session is worth a try, 0..1.
        seed: Root of every draw.
    """

    samples: int = 16
    threshold: float = 0.7
    seed: int = 0


class Rollouts(msgspec.Struct, frozen=True, kw_only=True):
    """What some rollouts came to.

    Attributes:
        samples: Rollouts that came to an end; one where the rehearsal itself failed.
        succeeded: Those of them in which the acceptance was true at the end.
        causes: Coded cause of a failed rollout -> how often.
    """

    samples: int
    succeeded: int
    causes: dict[str, int] = {}

    @property
    def share(self) -> float:
        """Of its rollouts, that succeeded, 0..1; 0 without rollouts."""
        return self.succeeded / self.samples if self.samples else 0.0

    @property
    def likely_cause(self) -> str:
        """The commonest cause of failure, the first by name among equals; empty when there is none."""
        return min(self.causes, key=lambda cause: (-self.causes[cause], cause), default="")


class Alternative(Rollouts, frozen=True, kw_only=True):
    """A strategy that was rehearsed, in the same imagined worlds as the contract's own."""

    strategy: Strategy


class LookaheadResult(Rollouts, frozen=True, kw_only=True):
    """The forecast of a session.

    Attributes:
        threshold: Least share that was asked for, 0..1.
        cost_ms: Wall time of the whole forecast, other strategies included [ms].
        notes: What a person should know: what was left out, how the noise was chosen.
        alternatives: Other strategies that were rehearsed since this one looked bad, the best first.
    """

    threshold: float
    cost_ms: float = 0.0
    notes: tuple[str, ...] = ()
    alternatives: tuple[Alternative, ...] = ()

    @property
    def is_low(self) -> bool:
        """Whether fewer rollouts succeeded than were asked for."""
        return self.share < self.threshold


def read_lookahead(folder: Path) -> LookaheadResult | None:
    """The look-ahead result of a bundle; None without one; raises ExecutionError `EVIDENCE_UNREADABLE`."""
    path = folder / LOOKAHEAD
    try:
        return msgspec.json.decode(path.read_bytes(), type=LookaheadResult)
    except FileNotFoundError:
        return None
    except (msgspec.MsgspecError, OSError) as error:
        raise ExecutionError("EVIDENCE_UNREADABLE", f"{path}: {error}") from error
