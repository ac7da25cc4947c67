"""Repair alternatives, and the choice among them.

They are tried in falling order of chance per cost, which is the order of least expected cost when each may fail on its
own (Simon and Kadane 1975, doi:10.1016/0004-3702(75)90002-3).
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from phyagentos.agent.goals.compiler import Revision
from phyagentos.agent.goals.selector import Choice
from phyagentos.agent.repair.case import Case
from phyagentos.wording import format_share

SESSION_S = 12.0  # declared simulated time of a session of manipulation, until one of the goal is measured [s]
CHANCE_MIN = 0.05  # what is less likely to help is not worth a session


class AlternativeKind(StrEnum):
    """What is done next."""

    RETRY = "retry"
    BEGIN_ANEW = "begin anew"
    OTHER_GRASP = "another grasp"
    OTHER_SKILL = "another skill"
    CLEAR = "clear the obstruction"
    OTHER_TARGET = "another target"
    LOOK = "look again"
    GIVE_UP = "give up"


@dataclass(frozen=True, slots=True, kw_only=True)
class Alternative:
    """One way to repair a node.

    Attributes:
        chance: That it meets the node's objective, 0..1.
        because: Why it is possible, or why it is not likely.
        revision: Of the child; None where there is none.
    """

    kind: AlternativeKind
    effect: str
    chance: float
    sessions: int = 1
    sim_time_s: float = SESSION_S
    because: str = ""
    revision: Revision | None = None

    @property
    def worth(self) -> float:
        """Chance per second."""
        return self.chance / max(self.sim_time_s, 1e-9)

    def __str__(self) -> str:
        """`pick_and_place again at half speed; estimated success 75 %, 12 s`."""
        if self.kind is AlternativeKind.GIVE_UP:
            return self.effect
        time = f"{self.sim_time_s:.0f} s" + (f" in {self.sessions} sessions" if self.sessions != 1 else "")
        return f"{self.effect}; estimated success {format_share(self.chance)}, {time}"


def propose(
    case: Case,
    kind: AlternativeKind,
    choice: Choice,
    effect: str,
    chance: float,
    because: str,
    cost: tuple[int, float] | None = None,
    **child: Any,
) -> Alternative:
    """A child of the latest session with this choice; `child` are other fields of its revision.

    It costs one session of the time that its skill takes, unless `cost` says how many, and of what simulated time [s].
    """
    sessions, sim_time_s = cost or (1, case.time_of.get(choice.skill, SESSION_S))
    revision = Revision(parent=case.latest.id, choice=choice, **{"reasons": (because,)} | child)
    return Alternative(
        kind=kind,
        effect=effect,
        chance=chance,
        because=because,
        revision=revision,
        sessions=sessions,
        sim_time_s=sim_time_s,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """The chosen alternative, and the others in the order of their worth, each with the reason against it."""

    chosen: Alternative
    passed: tuple[tuple[Alternative, str], ...] = ()

    @property
    def reasons(self) -> tuple[str, ...]:
        """One sentence for each fact behind the decision, what is done first."""
        own = self.chosen.revision.reasons if self.chosen.revision else ()
        because = (self.chosen.because,) if self.chosen.because else ()
        over = (f"rather than {other.kind} ({format_share(other.chance)}): {why}" for other, why in self.passed)
        return tuple(dict.fromkeys((str(self.chosen), *own, *because, *over)))


def choose_by_worth(case: Case, alternatives: list[Alternative]) -> Decision:
    """The affordable alternative of least expected cost; giving up when there is none."""
    ranked = sorted(alternatives, key=lambda each: (-each.worth, each.kind))
    passed: list[tuple[Alternative, str]] = []
    chosen: Alternative | None = None
    for each in ranked:
        excess = case.left.find_excess(each.sessions, each.sim_time_s)
        if each.chance < CHANCE_MIN:
            passed.append((each, each.because or "it is not likely to help"))
        elif excess:
            passed.append((each, excess))
        elif chosen is None:
            chosen = each
        else:
            passed.append((each, f"it is worth {format_share(each.worth / chosen.worth)} as much a second"))
    if chosen is None:
        why = "; ".join(f"{other.kind}: {reason}" for other, reason in passed) or "no other repair is known"
        chosen = Alternative(
            kind=AlternativeKind.GIVE_UP,
            effect="given up",
            chance=0.0,
            sessions=0,
            sim_time_s=0.0,
            because=why,
        )
        passed = []
    return Decision(chosen=chosen, passed=tuple(passed))
