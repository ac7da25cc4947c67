"""The planner that ships: bounded planning as answer set programming by clingo; `planning.lp` is the encoding.

Rounds of independent operators are added until a goal is reached; of the plans with the fewest rounds, one of least
cost is taken. That there is no plan is proven by relaxed reachability, or by induction: no path of so many different
states ends in the goal, wherever it begins. Limits count conflicts, not time: an answer is the same everywhere.
"""

from collections import Counter
from importlib.resources import files

import clingo

from phyagentos.agent.planning.problem import (
    Fact,
    Operator,
    Plan,
    PlanningProblem,
    ProvenUnsolvable,
)

ROUNDS_MAX = 24
CONFLICTS_MAX = 200_000  # of one round's search
CONFLICTS_BETTER = 10_000  # to find a cheaper plan than the first one
CONFLICTS_PROOF, ROUNDS_PROOF = 20_000, 6  # of the proof that there is none


def solve(problem: PlanningProblem) -> Plan | ProvenUnsolvable | None:
    """A plan of the fewest rounds, then of least cost; a proof that there is none; None: neither within the limits."""
    operators, unreachable = _reach(problem)
    if unreachable:
        return ProvenUnsolvable(unreachable)
    program = _describe(problem, operators)
    paths, proof = _Search(program), _Search(program, free=True)
    for rounds in range(ROUNDS_MAX + 1):
        found = paths.find(rounds, CONFLICTS_MAX)
        if found is None:
            return None
        if found:
            return _read_plan(found, operators, problem, rounds)
        if rounds <= ROUNDS_PROOF and proof.find(rounds, CONFLICTS_PROOF) == []:
            return ProvenUnsolvable()
    return None


class _Search:
    """One program with a growing number of rounds; `free` begins it anywhere and keeps its states apart."""

    def __init__(self, program: str, *, free: bool = False) -> None:
        options = ["--opt-strategy=bb,dec", "--seed=1", "--configuration=trendy", "--warn=none"]
        self._control, self._free, self._rounds = clingo.Control(options), free, -1
        self._control.add("base", [], program)
        self._control.add("base", [], (files(__package__) / "planning.lp").read_text(encoding="utf-8"))

    def find(self, rounds: int, conflicts: int) -> list[clingo.Symbol] | None:
        """The chosen operators and what was reached after so many rounds; empty without a plan, None at the limit."""
        control, number = self._control, clingo.Number
        for t in range(self._rounds + 1, rounds + 1):
            parts = [("base", [])] if t == 0 else [("step", [number(t)])]
            parts += [("simple", [number(t)])] if self._free and t else []
            control.ground([*parts, ("check", [number(t)])])
            control.assign_external(clingo.Function("free"), self._free)
            if t:
                control.release_external(clingo.Function("query", [number(t - 1)]))
        self._rounds = rounds
        control.assign_external(clingo.Function("query", [number(rounds)]), True)
        best: list[clingo.Symbol] = []
        for limit in (conflicts,) if self._free else (conflicts, CONFLICTS_BETTER):
            control.configuration.solve.solve_limit = str(limit)  # type: ignore[union-attr]
            control.configuration.solve.opt_mode = "opt" if best else "ignore"  # type: ignore[union-attr]
            with control.solve(yield_=True) as handle:
                for model in handle:
                    best = [*model.symbols(atoms=True)]
                result = handle.get()
            if not best:
                return [] if result.unsatisfiable else None
        return best


def _reach(problem: PlanningProblem) -> tuple[list[Operator], tuple[Fact, ...]]:
    """Operators that can ever be used if nothing is undone, and literals of the goal that can then never come true."""
    conditions = [each for stage in problem.stages for each in stage]
    known = {fact for operator in problem.operators for fact in (*operator.requires, *operator.changes)}
    known |= {fact for each in conditions for fact, _ in each.literals}
    possible = {(fact, fact in problem.initial) for fact in known | problem.initial}
    usable: set[str] = set()
    while more := [
        each for each in problem.operators if each.name not in usable and possible.issuperset(each.requires.items())
    ]:
        usable.update(each.name for each in more)
        possible.update(change for each in more for change in each.changes.items())
    missing = [[literal for literal in each.literals if literal not in possible] for each in conditions]
    pairs = zip(conditions, missing, strict=True)
    short = (literals for each, literals in pairs if len(each.literals) - len(literals) < each.least)
    unreachable = dict.fromkeys(fact for literals in short for fact, _ in literals)
    return [each for each in problem.operators if each.name in usable], tuple(unreachable)


def _describe(problem: PlanningProblem, operators: list[Operator]) -> str:
    """The problem as facts of a logic program; facts and operators are numbers."""
    changed = dict.fromkeys(fact for each in operators for fact in each.changes)
    named = dict.fromkeys([*changed, *sorted(problem.initial)])
    named |= dict.fromkeys(fact for stage in problem.stages for each in stage for fact, _ in each.literals)
    number = {fact: index for index, fact in enumerate(named)}
    lines: list[str] = []
    for index, operator in enumerate(operators):
        lines.append(f"operator({index}). cost({index},{operator.cost}).")
        lines += [f"require({index},{number[f]},{v:d})." for f, v in operator.requires.items() if f in changed]
        lines += [f"change({index},{number[fact]},{value:d})." for fact, value in operator.changes.items()]
    lines.append(f"last({len(problem.stages) - 1}).")
    for index, stage in enumerate(problem.stages):
        lines.append(f"stage({index}).")
        for place, each in enumerate(stage):
            lines.append(f"condition({index},{place},{each.least},{each.most}).")
            lines += [f"literal({index},{place},{number[fact]},{value:d})." for fact, value in each.literals]
    lines += [f"init({number[fact]})." for fact in sorted(problem.initial)]
    for index, capacity in enumerate(problem.capacities):
        lines.append(f"capacity({index},{capacity.most}).")
        lines += [f"weight({index},{number[f]},{w})." for f, w in capacity.weights.items() if f in number]
    for index, group in enumerate(problem.exclusive):
        lines.append(f"exclusive({index})." + f" exact({index})." * (group in problem.exact))
        lines += [f"member({index},{number[fact]})." for fact in sorted(group) if fact in number]
    return "\n".join(lines)


def _read_plan(symbols: list[clingo.Symbol], operators: list[Operator], problem: PlanningProblem, rounds: int) -> Plan:
    chosen = sorted((s.arguments[1].number, s.arguments[0].number) for s in symbols if s.match("do", 2))
    held = Counter(s.arguments[0].number for s in symbols if s.match("reached", 2))  # from some round to the last one
    borders = [rounds + 1 - held[index] for index in range(len(problem.stages) - 1)]
    before = (sum(t <= border for t, _ in chosen) for border in borders)
    return Plan(tuple(operators[index] for _, index in chosen), (*before, len(chosen)))
