"""Safety events as lessons: what stopped a session, or changed its commands, where it may happen again.

A caution is a fact, not a correction: it advises nothing, raises the risk of a case in its scope, and stands in the
contract as a sentence. What helps against it is learned as any other correction is.
"""

import msgspec

from phyagentos.agent.memory.episodes import Episode
from phyagentos.agent.memory.scopes import compute_id, compute_scope
from phyagentos.agent.memory.semantic import Count
from phyagentos.protocol.sessions.memory_entries import Scope, Standing

LATEST_KEPT = 5  # sessions and bundles that are named
RARE = 0.1  # share of sessions that surely is not exceeded before a caution lapses


class Caution(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One kind of safety event in one scope.

    Attributes:
        code: What happened (`ESTOPPED`, `HOLD_VIOLATED`, a broken limit).
        events: Sessions in the scope that it happened in, of all since the first.
    """

    id: str
    scope: Scope
    code: str
    objective: str = ""
    events: Count = Count()
    sessions: tuple[str, ...] = ()
    evidence: tuple[str, ...] = ()
    last_seq: int = 0
    state: Standing = Standing.ACTIVE
    reason: str = ""
    note: str = ""
    amended: Scope | None = None
    by: str = ""

    @property
    def where(self) -> Scope:
        """Its scope, as amended."""
        return self.amended or self.scope

    def add(self, episode: Episode, seq: int) -> "Caution":
        """The caution after one more session in its scope."""
        if self.code not in episode.safety:
            return msgspec.structs.replace(self, events=self.events.add(success=False))
        evidence = tuple(dict.fromkeys((*self.evidence, *filter(None, (episode.evidence,)))))
        return msgspec.structs.replace(
            self,
            events=self.events.add(success=True),
            sessions=(*self.sessions, episode.session)[-LATEST_KEPT:],
            evidence=evidence[-LATEST_KEPT:],
            last_seq=seq,
        )


def begin(episode: Episode) -> list[Caution]:
    """The cautions of an episode's safety events, without any count."""
    scope = msgspec.structs.replace(compute_scope(episode), risk=None)  # it holds whatever else is at stake
    return [
        Caution(id=compute_id("caution", scope, code, {}), scope=scope, code=code, objective=episode.objective)
        for code in episode.safety
    ]


def judge(caution: Caution) -> tuple[Standing, str]:
    """Whether the caution counts: one event is enough, and only many sessions without another end it."""
    if caution.state is Standing.RETRACTED:
        return Standing.RETRACTED, caution.reason
    if caution.events.interval[1] < RARE:
        return Standing.EXPIRED, f"it is rare by now: {caution.events} sessions"
    return Standing.ACTIVE, ""
