"""Memory at 100 000 episodes: what it costs to ask, to remember, to begin, and how long the document gets.

    python benchmarks/memory.py

Synthetic episodes through the ordinary doors (`Memory.record`, `recall`): hundreds of kinds of things in hundreds of
scenes, each with a correction that helps or does not. Nothing is simulated; what is learned by acting is measured by
`paos bench run evolution`.
"""

import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.runner import finish, run, show_figures
from phyagentos.agent.memory.episodes import Episode, Features
from phyagentos.agent.memory.memory import Memory
from phyagentos.agent.memory.scopes import compute_scope
from phyagentos.bench.report import Ask, Spread
from phyagentos.clock import SystemClock
from phyagentos.protocol.documents.document import read_document
from phyagentos.protocol.sessions.knowledge import render_knowledge
from phyagentos.protocol.sessions.lessons import LESSONS, render_lessons
from phyagentos.protocol.sessions.memory_entries import Embodiment
from phyagentos.protocol.sessions.strategy import Strategy
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.protocol.world.seeds import compute_seed

EPISODES = 100_000
KINDS, PLACES, SCENES = 300, 40, 30
BATCH = 500
QUESTIONS = 500
GOAL_SESSIONS = 4  # recorded as one at the end of a goal
CAUSES = ("GRASP_LOST", "GRASP_MISSED", "PLACED_WRONG", "OBJECT_MOVED")
BODY = Embodiment(kind="arm", grip_width_m=0.08, grip_force_n=40.0, control_period_s=0.02)
ASKED = {
    "recall_ms_p95": Ask(20.0, at_least=False),
    "lessons_in_document": Ask(500.0, at_least=False),
    "facts_in_document": Ask(500.0, at_least=False),
    "unverified_recalled": Ask(0.0, at_least=False),
    "lost_without_cache": Ask(0.0, at_least=False),
}


def draw_strategy(rng: np.random.Generator, cause: str) -> Strategy:
    """What a replanner might try."""
    if cause == "PLACED_WRONG":
        return Strategy(avoid_sites=(f"site{rng.integers(4)}",), speed=0.5)
    return {"speed": float(rng.choice([0.5, 0.25])), "avoid_grasps": [f"yaw+{90 * rng.integers(4):03d}"]}


def iter_episodes(count: int, rng: np.random.Generator) -> Iterator[Episode]:
    """First attempts; of those that fail most have a child, which helps more or less often, by the kind of thing."""
    number = 0
    while number < count:
        kind, place, scene = rng.integers(KINDS), rng.integers(PLACES), rng.integers(SCENES)
        cause = CAUSES[kind % len(CAUSES)]
        fails, helps = (kind % 7) / 8, (kind % 5) / 4
        first = Episode(
            session=f"goal-{number}.node",
            goal=f"goal-{number}",
            node="node",
            objective=f"Put thing{kind} into place{place}.",
            skill="pick_and_place",
            target="panda",
            body=BODY,
            scene=f"rooms/scene{scene}",
            seed=number,
            features=Features(object_kind=f"thing{kind}", destination_kind=f"place{place}"),
            verdict=Verdict.REPLAN if rng.random() < fails else Verdict.SUCCESS,
            evidence=f"evidence/goal-{number}.node",
        )
        yield first if first.is_success else msgspec.structs.replace(first, cause=cause)
        number += 1
        if not first.is_success and rng.random() < 0.9:
            is_success = bool(rng.random() < helps)
            yield make_child(first, draw_strategy(rng, cause), is_success, cause)
            number += 1


def make_child(first: Episode, strategy: Strategy, is_success: bool, cause: str) -> Episode:
    """What revised a failure."""
    return msgspec.structs.replace(
        first,
        session=f"{first.session}.r1",
        parent=first.session,
        strategy=strategy,
        verdict=Verdict.SUCCESS if is_success else Verdict.REPLAN,
        cause="" if is_success else cause,
        evidence=f"{first.evidence}.r1",
    )


def fill(memory: Memory, episodes: list[Episode]) -> float:
    """Remember them all, many at once; how long that took [s]."""
    begin_s = time.perf_counter()
    for index in range(0, len(episodes), BATCH):
        memory.record(episodes[index : index + BATCH])
    return time.perf_counter() - begin_s


def ask(memory: Memory, episodes: list[Episode], rng: np.random.Generator) -> tuple[list[float], int, int]:
    """Times of questions [ms], answers that no verdict supports, and how many answers there were."""
    spent_ms, unverified, answers = [], 0, 0
    for index in rng.integers(len(episodes), size=QUESTIONS):
        episode = episodes[int(index)]
        scope = compute_scope(episode)
        begin_s = time.perf_counter()
        found = memory.recall(scope)
        spent_ms.append(1e3 * (time.perf_counter() - begin_s))
        answers += len(found)
        unverified += sum(not each.lesson.tried.successes for each in found)
    return spent_ms, unverified, answers


def time_ms(action: object, *, times: int = 1) -> float:
    """Median duration of a call [ms]."""
    spent = []
    for _ in range(times):
        begin_s = time.perf_counter()
        action()  # type: ignore[operator]
        spent.append(1e3 * (time.perf_counter() - begin_s))
    return float(np.median(spent))


def main(*, episodes: int = EPISODES) -> int:
    """Run, show, and exit with whether every asked figure holds."""
    rng = np.random.default_rng(compute_seed(5, "memory benchmark"))
    known_episodes = list(iter_episodes(episodes, rng))
    extra = iter(list(iter_episodes(20 * GOAL_SESSIONS, np.random.default_rng(9))))
    with tempfile.TemporaryDirectory(prefix="memory-") as scratch:
        folder = Path(scratch) / "memory"

        def open_it() -> Memory:
            return Memory(folder, clock=SystemClock(), by="bench", durable=False)

        memory = open_it()
        fill_s = fill(memory, known_episodes)
        spent_ms, unverified, answers = ask(memory, known_episodes, rng)
        lessons, facts = memory.experience.list_lessons(), memory.experience.list_facts()
        text = render_lessons(lessons)
        sizes = [len(read_document(text, LESSONS).blocks), len(facts)]
        document_ms = time_ms(lambda: (render_lessons(memory.experience.list_lessons()), render_knowledge(facts)))
        version, known = memory.version, len(memory.experience.corrections)
        warm_ms = time_ms(open_it, times=5)
        shutil.rmtree(Path(scratch) / ".cache")
        begin_s = time.perf_counter()
        memory = open_it()
        rebuild_s = time.perf_counter() - begin_s
        lost = float(memory.version != version or memory.experience.list_lessons() != lessons)
        goal = [[episode for episode, _ in zip(extra, range(GOAL_SESSIONS), strict=False)] for _ in range(10)]
        record_ms = Spread.of([time_ms(lambda each=each: memory.record(each)) for each in goal]).median
        bytes_of_truth = sum(path.stat().st_size for path in folder.rglob("*.md"))
    spread = Spread.of(spent_ms)
    figures = {
        "episodes": float(episodes),
        "recall_ms_median": spread.median,
        "recall_ms_p95": spread.p95,
        "recall_ms_worst": max(spent_ms),
        "record_goal_ms": record_ms,
        "start_ms": warm_ms,
        "rebuild_s": rebuild_s,
        "fill_s": fill_s,
        "render_documents_ms": document_ms,
        "answers": float(answers),
        "lessons_known": float(known),
        "document_kb": len(text.encode()) / 1e3,
        "records_mb": bytes_of_truth / 1e6,
        "lessons_in_document": float(sizes[0]),
        "facts_in_document": float(sizes[1]),
        "unverified_recalled": float(unverified),
        "lost_without_cache": lost,
    }
    show_figures(f"{KINDS} kinds, {PLACES} places, {SCENES} scenes", figures, ASKED)
    return finish(figures, ASKED)


if __name__ == "__main__":
    run(main)
