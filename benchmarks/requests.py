"""What the embedded understander makes of written requests, each beside what is right.

    python benchmarks/requests.py
    python benchmarks/requests.py --wrong     # and every request that is not right
    python benchmarks/requests.py FOLDER      # requests of your own, in the form of tests/requests

Right is the expected goal, question or refusal. Goals are compared as sets: of predicates, of constraints, and of each
step. Not right and safe is a question or refusal where there is a goal; silently wrong is another goal than the
expected one, or any where there is none.
"""

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import yaml
from rich.console import Console
from typer import Argument, Option

from benchmarks.runner import finish, run, show_figures
from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.understanding.embedded import EmbeddedUnderstander
from phyagentos.agent.understanding.inquiries import answer as answer_inquiry
from phyagentos.agent.understanding.understanding import Ambiguous, Impossible, Inquiry, Understanding, Understood
from phyagentos.agent.understanding.vocabulary import Vocabulary
from phyagentos.assembly.project import open_library
from phyagentos.assembly.scene_start import draw_start
from phyagentos.bench.report import Threshold
from phyagentos.protocol.predicates.predicate import parse_predicate
from phyagentos.protocol.world.environment import Environment

REQUESTS = Path(__file__).parent.parent / "tests" / "requests"
LEAST, LEAST_UNSEEN = {"written_right": 0.9}, 0.75
SETS = {"written": REQUESTS} | {name: REQUESTS / name for name in ("held_out", "second", "third", "kinds")}


class Grade(StrEnum):
    """What an answer is worth."""

    RIGHT = "right"
    SAFE = "safe"
    WRONG = "silently wrong"


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One request with what is right, as written."""

    scene: str
    say: str
    expected: Mapping[str, Any]


def read_cases(folder: Path) -> Iterator[Case]:
    """Every request in the files of a folder, not of those below it."""
    for path in sorted(folder.glob("*.yaml")):
        for part in yaml.safe_load_all(path.read_text(encoding="utf-8")):
            for entry in part["requests"]:
                expected = {key: value for key, value in entry.items() if key != "say"}
                yield Case(scene=part["scene"], say=entry["say"], expected=expected)


def grade(answer: Understanding, expected: Mapping[str, Any], world: Environment | None = None) -> Grade:
    """Compare an answer with what is right; a question about the world is answered from `world`."""
    if any(_is_right(answer, one, world) for one in expected.get("any_of", [expected])):
        return Grade.RIGHT
    return Grade.WRONG if isinstance(answer, Understood) else Grade.SAFE


def _is_right(answer: Understanding, expected: Mapping[str, Any], world: Environment | None) -> bool:
    match answer:
        case Understood(goal=goal) if "choose" in expected:
            chosen = {*_canonical(goal.accept)}
            possible = _canonical(expected["choose"]["of"])
            return chosen <= possible and len(chosen) == expected["choose"]["count"] and not goal.steps
        case Understood(goal=goal) if "accept" in expected:
            return _outline(goal) == _outline(_as_goal(expected))
        case Ambiguous(questions=questions):
            asked = [{*question.candidates} for question in questions]
            return "safe" in expected or ("ask" in expected and {*expected["ask"]} in asked)
        case Inquiry() if "answer" in expected:
            said = answer_inquiry(answer, world)
            return all(part in " ".join((said.answer, *said.evidence)) for part in expected["answer"])
        case Inquiry():  # an answer changes nothing
            return "safe" in expected
        case Impossible(lacks=lacks):
            named = any(str(expected.get("refuse")) in lack.words for lack in lacks)
            return "safe" in expected or ("refuse" in expected and named)
    return False


def _as_goal(expected: Mapping[str, Any]) -> WantedGoal:
    parts = {key: expected.get(key, ()) for key in ("accept", "steps", "constraints")}
    return WantedGoal.model_validate({"goal": "expected", "objective": "", "scene": "", **parts}, strict=False)


def _outline(goal: WantedGoal) -> tuple[object, ...]:
    steps = tuple(_canonical(step) for step in goal.steps)
    return _canonical(goal.accept), steps, _canonical(goal.constraints)


def _canonical(texts: Sequence[str]) -> frozenset[str]:
    """Predicates as sets of their texts; a number that is left out is its default."""
    return frozenset(re.sub(r"(docked\(\w+, \w+)\)", r"\1, 0.4)", parse_predicate(text).text) for text in texts)


def measure(folder: Path) -> Iterator[tuple[Case, Understanding, Grade]]:
    """Each request of a folder with the answer and its grade."""
    library = open_library()
    catalogue, understander = Catalogue.read(library), EmbeddedUnderstander()
    scenes: dict[str, tuple[Environment, Vocabulary]] = {}
    for case in read_cases(folder):
        if case.scene not in scenes:
            start = draw_start(library, case.scene, ["panda"], 0)
            scenes[case.scene] = start, Vocabulary.read(catalogue, case.scene, world=start)
        world, vocabulary = scenes[case.scene]
        for earlier in case.expected.get("before", ()):
            met = understander.understand(earlier, vocabulary, {})
            vocabulary = replace(vocabulary, past=(*vocabulary.past, met.goal) if isinstance(met, Understood) else ())
        answer = understander.understand(case.say, vocabulary, {})
        yield case, answer, grade(answer, case.expected, world)


def main(
    folder: Annotated[Path | None, Argument()] = None,
    *,
    wrong: Annotated[bool, Option(help="print every request that is not right")] = False,
) -> int:
    """Print the table and the closing line; 0 where every asked figure holds."""
    sets = SETS if folder is None else {folder.name: folder}
    figures: dict[str, float] = {}
    for name, path in sets.items():
        results = list(measure(path))
        counts = Counter(grade for _, _, grade in results)
        figures[f"{name}_right"] = counts[Grade.RIGHT] / len(results)
        figures[f"{name}_silently_wrong"] = counts[Grade.WRONG]
        for case, answer, found in results if wrong else ():
            if found is not Grade.RIGHT:
                Console().print(f"{found}: {case.say}\n    {answer}", markup=False, highlight=False)
    asked = {
        key: Threshold(0.0, at_least=False)
        if key.endswith("wrong")
        else Threshold(LEAST.get(key, LEAST_UNSEEN), at_least=True)
        for key in figures
    }
    show_figures("requests in English", figures, asked)
    return finish(figures, asked)


if __name__ == "__main__":
    run(main)
