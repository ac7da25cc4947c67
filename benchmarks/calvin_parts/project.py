"""CALVIN as a project of this framework: its scene, and its instructions as goal graphs, by the understander."""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import yaml

from benchmarks.libero_parts.bddl import TIMEOUT_S, WALL_S
from benchmarks.libero_parts.foreign_scenes import Seen, write_scene
from benchmarks.libero_parts.tasks import write_model
from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.planning.answers import PlannedGoal, Unsolvable
from phyagentos.agent.planning.planned import plan_goal, write_graph
from phyagentos.agent.understanding.embedded import EmbeddedUnderstander
from phyagentos.agent.understanding.understanding import Ambiguous, Question, QuestionKind, Understanding, Understood
from phyagentos.agent.understanding.vocabulary import Vocabulary
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.world.environment import Entity, Environment

LIBRARY = Path(__file__).parent / "library"
ROBOT, SCENE = "calvin", "calvin_scene_D"
VIEW = "as seen by the robot"  # whose left and right is meant: who stands before the table looks as its robot does
FAR = ("20 cm", "30 cm", "50 cm")  # "push": the first of the shortest plans, as nothing else is to be moved for it
PROFILE = LIBRARY / "robots" / ROBOT / "target.yaml"


def read_profile() -> TargetProfile:
    """The profile of the arm, whatever its endpoint."""
    return read_target(PROFILE)


def read_world(told: Sequence[Mapping[str, Any]]) -> Environment:
    """A scene as its environment describes it."""
    entities = [msgspec.convert(each, Entity) for each in told]
    named = {each.name: each for each in entities}
    return Environment(time_s=0.0, scene=SCENE, episode="", revision=0, sensing="truth", entities=named)


def write_project(folder: Path, told: Mapping[str, Any], endpoint: str) -> None:
    """The project: one scene for all sequences, and the robot as this environment has it."""
    shutil.copytree(LIBRARY, folder, dirs_exist_ok=True)
    scene = folder / "scenes" / f"{SCENE}.yaml"
    scene.parent.mkdir(parents=True, exist_ok=True)
    entities = read_world(next(iter(told["sequences"].values()))["entities"]).entities.values()
    scene.write_text(write_scene(SCENE, "The table of CALVIN's scene D.", entities, {}, Seen()))
    profile = folder / "robots" / ROBOT / "target.yaml"
    profile.write_text(PROFILE.read_text().replace("ws://127.0.0.1:7000", endpoint))
    write_model(profile.with_name("panda.xml"), told["tool"], (), ())


def translate(instruction: str, catalogue: Catalogue, world: Environment) -> tuple[str, str]:
    """The goal graph of an instruction; empty, and what is open or missing, where it is not understood or planned."""
    vocabulary = Vocabulary.read(catalogue, SCENE, robot=ROBOT, world=world)
    plans: list[PlannedGoal] = []
    for far in FAR:
        kinds = {QuestionKind.VIEW: VIEW, QuestionKind.HOW_FAR: far}
        understood = _understand(instruction.lower(), vocabulary, kinds)
        if not isinstance(understood, Understood):
            return "", f"not understood: {_describe(understood)}"
        planned = plan_goal(understood.goal, catalogue, world)
        if isinstance(planned, Unsolvable):
            reason = f"no plan: {'; '.join(each.describe() for each in planned.missing)}"
            continue
        plans.append(planned)
        if len(planned.steps) < 2:
            break
    return _write(min(plans, key=lambda each: len(each.steps))) if plans else ("", reason)


def _write(planned: PlannedGoal) -> tuple[str, str]:
    if not planned.steps:
        return "", "met already"
    graph = yaml.safe_load(write_graph(planned))
    graph["defaults"] = graph.get("defaults", {}) | {"timeout_s": TIMEOUT_S, "max_replans": 3, **WALL_S}
    return yaml.safe_dump(graph, sort_keys=False, width=120), ""


def _understand(instruction: str, vocabulary: Vocabulary, kinds: Mapping[QuestionKind, str]) -> Understanding:
    """What it means; each question gets the answer that its kind has here, else the first candidate."""
    answers: dict[str, str] = {}
    while True:
        found = EmbeddedUnderstander().understand(instruction, vocabulary, answers)
        questions = found.questions if isinstance(found, Ambiguous) else ()
        if not questions or not all(each.candidates for each in questions):
            return found
        answers |= {each.key: _answer(each, vocabulary, kinds) for each in questions}


def _answer(question: Question, vocabulary: Vocabulary, kinds: Mapping[QuestionKind, str]) -> str:
    """What its kind has here; of several objects the one nearest to who stands before the table."""
    if (answer := kinds.get(question.kind)) in question.candidates:
        return str(answer)
    objects = {name: vocabulary.objects.get(name) for name in question.candidates}
    places = {name: each.at_m[0] for name, each in objects.items() if each is not None and each.at_m is not None}
    return min(question.candidates, key=lambda name: places.get(name, 0.0))


def _describe(found: Any) -> str:
    gaps: Sequence[Any] = getattr(found, "questions", ()) or getattr(found, "lacks", ())
    return "; ".join(f"{each.kind.value} {each.words!r}" for each in gaps) or type(found).__name__
