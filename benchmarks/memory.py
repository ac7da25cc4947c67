"""What memory answers after 50 000 lessons, how long that takes, and what it has forgotten by then.

    python benchmarks/memory.py            # some two minutes
    python benchmarks/memory.py --quick    # small numbers, for a look

A few cases matter: each has a lesson that was verified several times. All other lessons are noise of a kind that an
adversary would choose: half were tried and failed, half were verified once, none comes back. Three orders are tried,
each with three ways to forget: what ships, the least recently used, and chance.
"""

import random
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import Annotated, Any
from unittest import mock

import msgspec
from typer import Option

from benchmarks.runner import finish, run, show, show_figures
from phyagentos.agent.memory import experience as kept
from phyagentos.agent.memory.episodes import Episode, Features
from phyagentos.agent.memory.experience import Experience
from phyagentos.agent.memory.memory import Retrieval
from phyagentos.agent.memory.scopes import compute_scope
from phyagentos.bench.report import Threshold
from phyagentos.protocol.sessions.memory_entries import Embodiment, EntryState
from phyagentos.protocol.sessions.strategy import Strategy
from phyagentos.protocol.sessions.verdicts import Verdict

ASKED = {
    "answer_p99_ms": Threshold(5.0, at_least=False),
    "recalled_after_flood": Threshold(0.95, at_least=True),
    "recalled_in_bursts": Threshold(0.95, at_least=True),
}
CASES, CONFIRMED = 200, 4  # that matter; how often each was verified
BODY = Embodiment(kind="arm", grip_width_m=0.08, grip_force_n=40.0, control_period_s=0.02)
CHANGED = Strategy(speed=0.5)

Lesson = list[Episode]
Forget = Callable[[dict[str, Any], int, int], list[str]]
_numbers = count()


def main(
    *, quick: Annotated[bool, Option(help="Small numbers; only the order of the rows means anything.")] = False
) -> int:
    """Feed, ask, show, and exit with whether every asked figure holds."""
    lessons = 5_000 if quick else 50_000
    ways: dict[str, Forget] = {
        "as shipped": kept.choose_forgotten,
        "least recently used": choose_oldest,
        "by chance": Chance(random.Random(0)),
    }
    shares = {(order, way): 0.0 for order in ORDERS for way in ways}
    figures: dict[str, float] = {}
    for order, arrange in ORDERS.items():
        for way, forget in ways.items():
            known = learn(arrange(lessons), forget)
            shares[order, way] = measure_recall(known)
            if order == "flood" and way == "as shipped":
                figures |= measure_answers(known)
    figures["recalled_after_flood"] = shares["flood", "as shipped"]
    figures["recalled_in_bursts"] = shares["bursts", "as shipped"]
    rows = [(order, *(f"{100 * shares[order, way]:.0f} %" for way in ways)) for order in ORDERS]
    show(f"of {CASES} cases that matter, recalled after {lessons} other lessons", ("order", *ways), rows)
    show_figures("answers with memory at its bound", figures, ASKED)
    return finish(figures, ASKED)


def learn(lessons: Iterator[Lesson], forget: Forget) -> Experience:
    """What memory knows after these, forgetting in one way."""
    known = Experience()
    with mock.patch.object(kept, "choose_forgotten", forget):
        for lesson in lessons:
            known.extend((known.seq + 1 + index, episode) for index, episode in enumerate(lesson))
    return known


def measure_recall(known: Experience) -> float:
    """The share of the cases that matter whose lesson is recalled."""
    retrieval = Retrieval(known)
    return statistics.mean(bool(retrieval.recall(compute_scope(make_case(number)[0]))) for number in range(CASES))


def measure_answers(known: Experience) -> dict[str, float]:
    """How long memory takes to advise a session, and how much it holds."""
    retrieval = Retrieval(known)
    taken_ms = []
    for number in range(CASES):
        scope = compute_scope(make_case(number)[0])
        begin_s = time.perf_counter()
        retrieval.recall(scope), retrieval.find_promoted(scope), retrieval.warn(scope)
        taken_ms.append(1e3 * (time.perf_counter() - begin_s))
    ordered = sorted(taken_ms)
    return {
        "answer_p50_ms": statistics.median(ordered),
        "answer_p99_ms": ordered[int(0.99 * len(ordered))],
        "lessons_held": len(known.corrections),
        "megabytes": len(msgspec.json.encode(known)) / 1e6,
    }


def arrange_flood(others: int) -> Iterator[Lesson]:
    """What matters first, then all the noise."""
    for _ in range(CONFIRMED):
        yield from map(make_case, range(CASES))
    yield from map(make_noise, range(others))


def arrange_bursts(others: int) -> Iterator[Lesson]:
    """What matters is verified twice before each of three floods, each larger than memory."""
    for turn in range(CONFIRMED):
        yield from map(make_case, range(CASES))
        yield from map(make_case, range(CASES))
        share = others // CONFIRMED
        yield from map(make_noise, range(turn * share, (turn + 1) * share))


def arrange_mixed(others: int) -> Iterator[Lesson]:
    """The confirmations of one case lie as far apart as they can, in noise throughout."""
    every = others // (CASES * CONFIRMED)
    for number in range(others):
        if number % every == 0:
            yield make_case(number // every % CASES)
        yield make_noise(number)


ORDERS = {"flood": arrange_flood, "bursts": arrange_bursts, "mixed": arrange_mixed}


def make_case(number: int) -> Lesson:
    """A failure that matters, and the child that corrected it."""
    return _make(f"kept{number}", verified=True)


def make_noise(number: int) -> Lesson:
    """A failure that never comes back, and a child that helped every second time."""
    return _make(f"other{number}", verified=number % 2 == 0)


def _make(kind: str, *, verified: bool) -> Lesson:
    number = next(_numbers)
    failed = Episode(
        session=f"g{number}.n",
        goal=f"g{number}",
        node="n",
        seed=number,
        scene="bench",
        objective=f"Put the {kind} into the tray.",
        skill="pick_and_place",
        target="panda",
        body=BODY,
        features=Features(object=f"{kind}_1", object_kind=kind, destination="tray_1", destination_kind="tray"),
        verdict=Verdict.REPLAN,
        cause="GRASP_LOST",
        evidence=f"evidence/g{number}.n",
    )
    verdict, cause = (Verdict.SUCCESS, "") if verified else (Verdict.REPLAN, "GRASP_LOST")
    child = msgspec.structs.replace(
        failed, session=f"g{number}.n.r1", parent=failed.session, strategy=CHANGED, verdict=verdict, cause=cause
    )
    return [failed, child]


def choose_oldest(entries: dict[str, Any], many: int, _: int) -> list[str]:
    """Those that were used longest ago."""
    return [id for id, each in entries.items() if each.state is not EntryState.RETRACTED][:many]


@dataclass(frozen=True, slots=True)
class Chance:
    """Any."""

    rng: random.Random

    def __call__(self, entries: dict[str, Any], many: int, _: int) -> list[str]:
        """So many, each as likely."""
        return self.rng.sample(list(entries), many)


if __name__ == "__main__":
    run(main)
