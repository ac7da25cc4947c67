"""Look-ahead: the agent asks what a session is likely to lead to, the runtime simulates and answers. Paper section 4.2.

Upstream: the agent, which states how many samples it wants and what chance it asks for. Downstream: the runtime's
simulation writes the result into the evidence bundle as `lookahead.json`; the agent and the look-ahead judge read it
there. The request carries everything that is drawn, so that an answer can be computed again.
"""

from pathlib import Path

import msgspec

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.strategy import Strategy

LOOKAHEAD = "lookahead.json"  # LookaheadResult; absent when none was requested


class LookaheadRequest(msgspec.Struct, frozen=True, kw_only=True):
    """What the agent wants simulated before a session is committed.

    Attributes:
        samples: Rollouts at most, each with its own drawn poses and parameters; clear cases take fewer.
        threshold: Least share of successful rollouts with which the session is worth a try, 0..1.
        seed: Root of every draw.
    """

    samples: int = 16
    threshold: float = 0.7
    seed: int = 0


class Alternative(msgspec.Struct, frozen=True, kw_only=True):
    """A strategy that was rehearsed, in the same imagined worlds as the contract's own.

    Attributes:
        strategy: As in a contract.
        samples: Rollouts; one where it failed in the world as believed already.
        succeeded: Those of them in which the acceptance was true at the end.
        causes: Coded cause of a failed rollout -> how often.
    """

    strategy: Strategy
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
        return _find_commonest(self.causes)


class LookaheadResult(msgspec.Struct, frozen=True, kw_only=True):
    """What the rollouts came to.

    Attributes:
        samples: Rollouts that came to an end; one that failed where the session cannot even be rehearsed.
        succeeded: Those of them in which the acceptance was true at the end.
        threshold: Least share that was asked for, 0..1.
        causes: Coded cause of a failed rollout -> how often.
        cost_ms: Wall time of the whole forecast, other strategies included [ms].
        notes: What a person should know: what was left out, how the noise was chosen.
        alternatives: Other strategies that were rehearsed since this one looked bad, the best first.
    """

    samples: int
    succeeded: int
    threshold: float
    causes: dict[str, int] = {}
    cost_ms: float = 0.0
    notes: tuple[str, ...] = ()
    alternatives: tuple[Alternative, ...] = ()

    @property
    def share(self) -> float:
        """Of the rollouts, that succeeded, 0..1; 0 without rollouts."""
        return self.succeeded / self.samples if self.samples else 0.0

    @property
    def is_low(self) -> bool:
        """Whether fewer rollouts succeeded than were asked for."""
        return self.share < self.threshold

    @property
    def likely_cause(self) -> str:
        """The commonest cause of failure, the first by name among equals; empty when there is none."""
        return _find_commonest(self.causes)


def read_lookahead(folder: Path) -> LookaheadResult | None:
    """The look-ahead result of a bundle; None when none was requested.

    Raises:
        ExecutionError: `EVIDENCE_UNREADABLE` when it is damaged.
    """
    path = folder / LOOKAHEAD
    try:
        return msgspec.json.decode(path.read_bytes(), type=LookaheadResult)
    except FileNotFoundError:
        return None
    except (msgspec.MsgspecError, OSError) as error:
        raise ExecutionError("EVIDENCE_UNREADABLE", f"{path}: {error}") from error


def _find_commonest(causes: dict[str, int]) -> str:
    return min(causes, key=lambda cause: (-causes[cause], cause), default="")
