"""Safety events as lessons: what stopped a session, or changed its commands, where it may happen again.

A caution is a fact, not a correction: it advises nothing, raises the risk of a case in its scope, and stands in the
contract as a sentence. What helps against it is learned as any other correction is.
"""

import msgspec

from phyagentos.agent.judging.causes import Cause
from phyagentos.agent.memory.entries import Entry, name_objects
from phyagentos.agent.memory.episodes import Episode
from phyagentos.agent.memory.scopes import compute_id, compute_scope
from phyagentos.codes import get_present_name
from phyagentos.protocol.sessions.lessons import Lesson
from phyagentos.protocol.sessions.memory_entries import EntryState, Risk

SESSIONS_KEPT = 5  # that are named
RARE = 0.1  # share of sessions that surely is not exceeded before a caution lapses


class Caution(Entry, frozen=True, kw_only=True, omit_defaults=True):
    """One kind of safety event in one scope; a session in which it happened speaks for it.

    Attributes:
        code: What happened (`ESTOPPED`, `CONSTRAINT_VIOLATED`, a broken limit).
        condition: That did not hold; empty where none was violated.
    """

    code: str
    condition: str = ""
    objective: str = ""
    sessions: tuple[str, ...] = ()

    def add(self, episode: Episode, seq: int) -> "Caution":
        """The caution after one more session in its scope."""
        if self.code not in map(get_present_name, episode.safety) or self.condition not in {"", *episode.violated}:
            return msgspec.structs.replace(self, count=self.count.add(success=False))
        return msgspec.structs.replace(
            self,
            count=self.count.add(success=True),
            sessions=(*self.sessions, episode.session)[-SESSIONS_KEPT:],
            evidence=self.join_evidence(episode),
            last_seq=seq,
        )

    def _weigh(self, seq: int) -> tuple[EntryState, str]:
        """One event is enough, and only many sessions without another end it."""
        if self.count.interval[1] < RARE:
            return EntryState.EXPIRED, f"it is rare by now: {self.count} sessions"
        return EntryState.ACTIVE, ""

    def describe(self, seq: int) -> Lesson:
        """Its entry of LESSONS.md at record `seq` of memory."""
        where = self.where
        what = f"{where.skill} of {name_objects(where)} by {where.target}"
        return Lesson(
            statement=f"{what}: {self.code}{self.condition and f' ({self.condition})'} in {self.count} sessions.",
            **self.describe_common(seq),
            objective=self.objective,
            cause=self.code,
            condition=self.condition,
            risk=Risk.HIGH,
            verified_by=self.sessions[-1] if self.sessions else "",
        )


def begin(episode: Episode) -> list[Caution]:
    """The cautions of an episode's safety events, without any count."""
    scope = msgspec.structs.replace(compute_scope(episode), risk=None)  # it holds whatever else is at stake
    return [
        Caution(
            id=compute_id("caution", scope, code, {"condition": each} if each else {}),
            scope=scope,
            code=code,
            condition=each,
            objective=episode.objective,
        )
        for code in dict.fromkeys(map(get_present_name, episode.safety))
        for each in (episode.violated if code == Cause.CONSTRAINT_VIOLATED else ()) or ("",)
    ]
