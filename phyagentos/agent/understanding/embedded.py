"""The embedded understander: a grammar over the words of the scene. Knows no model and no network."""

from collections.abc import Mapping

from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.agent.understanding.clauses import Clauses, finish
from phyagentos.agent.understanding.nouns import Node, list_children
from phyagentos.agent.understanding.reading import Readings, read_request
from phyagentos.agent.understanding.understanding import (
    Ambiguous,
    Impossible,
    Question,
    QuestionKind,
    RequestProblemKind,
    Understanding,
    Understood,
    conclude,
)
from phyagentos.agent.understanding.vocabulary import Vocabulary
from phyagentos.protocol.predicates.predicate import find_entities

READING = "reading"  # key of the question which of several readings is meant


class EmbeddedUnderstander:
    """Reads a request by the grammar; what it does not know is asked or refused, never skipped."""

    def understand(self, request: str, vocabulary: Vocabulary, answers: Mapping[str, str]) -> Understanding:
        """The goal of a request, or why there is none; `answers` maps keys of questions to the chosen candidates."""
        read = read_request(request, vocabulary)
        if isinstance(read, Impossible):
            return read
        results = [_interpret(tree, read, request, vocabulary, answers) for tree in read.trees]
        goals = {_summarise(result.goal): result for result in results if isinstance(result, Understood)}
        if len(goals) > 1 and (answer := answers.get(READING)) not in goals:
            question = Question(kind=QuestionKind.READING, key=READING, words=request, candidates=tuple(goals))
            return Ambiguous(questions=(question,))
        if goals:
            return next(iter(goals.values())) if len(goals) == 1 else goals[str(answer)]
        if asked := [result for result in results if isinstance(result, Ambiguous)]:
            return min(asked, key=lambda result: len(result.questions))
        refused = (result for result in results if isinstance(result, Impossible))
        return min(refused, key=lambda result: len(result.lacks))


def _interpret(
    tree: Node, read: Readings, request: str, vocabulary: Vocabulary, answers: Mapping[str, str]
) -> Understanding:
    said = Clauses(text=read.text, vocabulary=vocabulary, answers=answers)
    steps, accept = finish(said.read_plan(list_children(tree)[0]))
    constraints = tuple(said.constraints)
    if said.again and not vocabulary.past:
        said.lack(RequestProblemKind.PAST, read.text)
    elif said.again:
        past, excepted = vocabulary.past[-1], set(said.excepted)
        before = (past.constraints, *past.steps, past.accept)
        kept = [tuple(text for text in texts if not excepted & set(find_entities(text))) for texts in before]
        said.reasons.append(f"as before: {past.objective}")
        constraints = tuple(dict.fromkeys((*kept[0], *constraints)))
        steps = (*(step for step in kept[1:-1] if step), *steps)
        accept = tuple(dict.fromkeys((*kept[-1], *accept)))
    if not accept and not said.lacks and not said.questions:
        said.lack(RequestProblemKind.GOAL, read.text)
    if said.lacks:
        return Impossible(lacks=tuple(dict.fromkeys(said.lacks)))
    if said.questions:
        return Ambiguous(questions=tuple(dict.fromkeys(said.questions)))
    parts = {"constraints": constraints, "steps": steps, "accept": accept}
    reasons, chosen = (tuple(dict.fromkeys(each)) for each in (said.reasons, said.chosen))
    told = {"reasons": reasons, "left_out": said.left_out, "unsaid": (*read.unsaid, *said.unsaid), "chosen": chosen}
    return conclude(request, vocabulary, parts, **told)


def _summarise(goal: WantedGoal) -> str:
    """A goal in one line, to be chosen from."""
    always = f"; always {', '.join(goal.constraints)}" if goal.constraints else ""
    return ", then ".join(map(", ".join, (*goal.steps, goal.accept))) + always
