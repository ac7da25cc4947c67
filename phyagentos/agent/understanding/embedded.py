"""The embedded understander: a grammar over the words of the scene. Knows no model and no network."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from typing_extensions import override

from phyagentos.agent.goals.spec import NAME_MAX, WantedGoal
from phyagentos.agent.understanding.check import find_lacks
from phyagentos.agent.understanding.clauses import Clauses, finish
from phyagentos.agent.understanding.nouns import Discourse, Node
from phyagentos.agent.understanding.reading import Readings, read_request
from phyagentos.agent.understanding.understanding import (
    Ambiguous,
    Impossible,
    Lack,
    LackKind,
    Question,
    QuestionKind,
    Understander,
    Understanding,
    Understood,
)
from phyagentos.agent.understanding.vocabulary import ROLE, Vocabulary
from phyagentos.protocol.world.predicates.predicate import find_entities

READING = "reading"  # key of the question which of several readings is meant


@dataclass(frozen=True, slots=True)
class EmbeddedUnderstander(Understander):
    """Reads a request by the grammar; what it does not know is asked or refused, never skipped."""

    @override
    def understand(self, request: str, vocabulary: Vocabulary, answers: Mapping[str, str]) -> Understanding:
        read = read_request(request, vocabulary)
        if not read.trees:
            return _refuse(read)
        results = [_interpret(tree, read, request, vocabulary, answers) for tree in read.trees]
        goals = {_summarise(result.goal): result for result in results if isinstance(result, Understood)}
        if len(goals) == 1:
            return next(iter(goals.values()))
        if goals:
            if (answer := answers.get(READING)) in goals:
                return goals[str(answer)]
            question = Question(kind=QuestionKind.READING, key=READING, words=request, candidates=tuple(goals))
            return Ambiguous(questions=(question,))
        asked = [result for result in results if isinstance(result, Ambiguous)]
        if asked:
            return min(asked, key=lambda result: len(result.questions))
        refused = [result for result in results if isinstance(result, Impossible)]
        return min(refused, key=lambda result: len(result.lacks))


def name_goal(request: str) -> str:
    """A name for the goal of a request: its first words."""
    name = ""
    for word in re.findall(r"[a-z0-9]+", request.lower()):
        if len(name) + len(word) > NAME_MAX // 2:
            break
        name += f"_{word}"
    name = name.strip("_")
    return name if re.match(r"[a-z]", name) else f"goal_{name}".strip("_")


def _refuse(read: Readings) -> Impossible:
    """Why there is no reading."""
    if read.unknown:
        words = ((word, near) for word, near in read.unknown.items())
        return Impossible(lacks=tuple(Lack(kind=LackKind.WORD, words=word, nearest=near) for word, near in words))
    return Impossible(lacks=(Lack(kind=LackKind.SENTENCE, words=read.stop or read.text),))


def _interpret(
    tree: Node, read: Readings, request: str, vocabulary: Vocabulary, answers: Mapping[str, str]
) -> Understanding:
    """What one reading means."""
    said = Discourse(text=read.text, vocabulary=vocabulary, answers=answers)
    clauses = Clauses(said)
    steps, accept = finish(clauses.read_plan(next(child for child in tree.children if not isinstance(child, str))))
    constraints = tuple(clauses.constraints)
    if clauses.again:
        past = vocabulary.past[-1] if vocabulary.past else None
        if past is None:
            said.lack(LackKind.PAST, read.text)
        else:
            before = (past.constraints, *past.steps, past.accept)
            kept = [tuple(text for text in texts if not _names(text, clauses.excepted)) for texts in before]
            said.reasons.append(f"as before: {past.objective}")
            constraints = tuple(dict.fromkeys((*kept[0], *constraints)))
            steps = (*(step for step in kept[1:-1] if step), *steps)
            accept = tuple(dict.fromkeys((*kept[-1], *accept)))
    if not accept and not said.lacks and not said.questions:
        said.lack(LackKind.GOAL, read.text)
    if said.lacks:
        return Impossible(lacks=tuple(dict.fromkeys(said.lacks)))
    if said.questions:
        return Ambiguous(questions=tuple(dict.fromkeys(said.questions)))
    goal = WantedGoal(
        goal=name_goal(request),
        objective=" ".join(request.split()),
        scene=vocabulary.scene,
        targets={ROLE: vocabulary.robot},
        constraints=constraints,
        steps=steps,
        accept=accept,
    )
    if lacks := find_lacks(goal, vocabulary):
        return Impossible(lacks=lacks)
    return Understood(
        goal=goal,
        reasons=tuple(dict.fromkeys(said.reasons)),
        left_out=clauses.left_out,
        unsaid=(*read.unsaid, *said.unsaid),
        chosen=tuple(dict.fromkeys(said.chosen)),
    )


def _names(text: str, names: list[str]) -> bool:
    return bool(set(names) & set(find_entities(text)))


def _summarise(goal: WantedGoal) -> str:
    """A goal in one line, to be chosen from."""
    steps = "".join(f"{', '.join(step)}, then " for step in goal.steps)
    always = f"; always {', '.join(goal.constraints)}" if goal.constraints else ""
    return f"{steps}{', '.join(goal.accept)}{always}"
