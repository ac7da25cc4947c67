"""What `paos ask` prints: questions, what is missing, and a goal with its plan; for people, or as plain data."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from phyagentos.cli.outcome import print_json, print_note, print_result
from phyagentos.cli.planning import print_plan

if TYPE_CHECKING:
    from phyagentos.agent.planning.planned import PlannedGoal
    from phyagentos.agent.understanding.understanding import Ambiguous, Impossible, Question, Understood


def put_questions(found: "Ambiguous") -> dict[str, str]:
    """Ask in the terminal."""
    chosen = {}
    for question in found.questions:
        print_note(_phrase(question))
        for number, candidate in enumerate(question.candidates, 1):
            print_note(f"  {number}  {candidate}")
        number = 0
        while not 1 <= number <= len(question.candidates):
            number = typer.prompt("number", type=int, err=True)
        chosen[question.key] = question.candidates[number - 1]
    return chosen


def print_open(found: "Ambiguous | Impossible", *, as_json: bool) -> None:
    """Each question with its candidates and how a script answers it; or each thing that is missing."""
    from phyagentos.agent.understanding.understanding import Ambiguous
    from phyagentos.agent.understanding.vocabulary import read_lexicon

    if isinstance(found, Ambiguous):
        if as_json:
            print_json({"understood": False, "questions": found.questions})
            return
        for question in found.questions:
            print_result(f"{_phrase(question)}: {', '.join(question.candidates) or 'say it'}")
            print_note(f"  --answer '{question.key}={next(iter(question.candidates), '...')}'")
        return
    if as_json:
        print_json({"understood": False, "lacks": found.lacks})
        return
    for lack in found.lacks:
        near = f"; nearest is {lack.nearest!r}" if lack.nearest else ""
        possible = f"; possible: {', '.join(lack.possible)}" if lack.possible else ""
        print_result(f"{lack.words!r} {read_lexicon()['lacks'][lack.kind]}{near}{possible}")


def _phrase(question: "Question") -> str:
    from phyagentos.agent.understanding.vocabulary import read_lexicon

    return f"{read_lexicon()['questions'][question.kind]} {question.words!r}"


def show(understood: "Understood", planned: "PlannedGoal", *, mermaid: bool) -> None:
    """The goal, what was left open or out, and the graph with its reasons."""
    from phyagentos.agent.planning.planned import render_mermaid

    goal = understood.goal
    lines = [f"{goal.goal}  in {goal.scene}", *(f"  first   {', '.join(step)}" for step in goal.steps)]
    lines.append(f"  wanted  {', '.join(goal.accept)}")
    lines += [f"  always  {', '.join(goal.constraints)}"] if goal.constraints else []
    left_out = understood.left_out.items()
    lines += [f"  LEFT OUT {name}, which stays where it is: there is no {missing}" for name, missing in left_out]
    lines += [f"  no predicate says {word!r}; it changes nothing" for word in understood.unsaid]
    lines += [f"  because {reason}" for reason in understood.reasons]
    print_result("\n".join(lines))
    if mermaid and planned.steps:
        print_result(render_mermaid(planned))
    else:
        print_plan(planned)


def describe(understood: "Understood", planned: "PlannedGoal", graph: Path | None) -> dict[str, Any]:
    """All that was understood, as plain data."""
    return {
        "understood": True,
        "goal": understood.goal.model_dump(mode="json"),
        "reasons": understood.reasons,
        "left_out": dict(understood.left_out),
        "unsaid": understood.unsaid,
        "chosen": understood.chosen,
        "sessions": [step.name for step in planned.steps],
        "graph": str(graph) if graph is not None else None,
    }
