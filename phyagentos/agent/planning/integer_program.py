"""The engine of amounts that ships: integer programs by HiGHS, which scipy brings.

As in planning by integer programming (Vossen et al. 1999), rounds are added until a goal is reached; what a round makes
is there from the next one on. Each activity is one session of a round, up to `TIMES_MAX` times. That there is no plan
is proven by relaxed reachability, or by the state equation: amounts suffice in no order. A plan costs at most a tenth
more than the cheapest of its rounds, which need not be the cheapest of all. A plan of more than `ROUNDS_MAX` rounds a
stage is not found, nor a proof where amounts suffice and only their order is impossible. Limits count nodes of all
programs together, not time; only a program that takes longer than `LONG_S`, for nodes can be slow, ends the search with
what it has found by then.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from phyagentos.agent.planning.amounts import (
    Activity,
    AmountPlan,
    AmountProblem,
    Batch,
    Resource,
    Shortage,
    find_reachable,
    iter_amounts,
)

ROUNDS_MAX = 30
TIMES_MAX = 256
PROOF_TIMES_MAX = 1_000_000  # of each activity: a proof says nothing of longer plans
NODES_MAX = 5_000
LONG_S = 20.0
SESSION_S = 10.0  # what a session costs beside its own time [s]
GAP = 0.1
_SLACK = 1e-6  # of amounts of vitals, which are no whole numbers
_AT_LIMIT, _INFEASIBLE = 1, 2  # as scipy reports it


def solve(problem: AmountProblem) -> AmountPlan | Shortage | None:
    """A plan of the fewest rounds; a proof that there is none; None: neither within the limits."""
    nothing = AmountPlan((), (0,) * len(problem.stages))
    if is_valid(problem, nothing):
        return nothing
    reachable, rounds = find_reachable(problem)
    wanted = [name for stage in problem.stages for name, (least, _) in stage.items() if least > 0]
    if unreachable := tuple(dict.fromkeys(name for name in wanted if name not in reachable)):
        return Shortage(unreachable)
    if _Program(problem, 1, is_ordered=False).is_infeasible():
        return _find_short(problem)
    nodes_left = NODES_MAX
    for each in range(max(rounds, 1), ROUNDS_MAX + 1):
        program = _Program(problem, each * len(problem.stages), nodes_max=nodes_left)
        if (plan := program.find_plan()) is not None:
            return plan
        nodes_left -= program.nodes
        if program.is_cut_short or nodes_left <= 0:
            break
    return None


def _find_short(problem: AmountProblem) -> Shortage:
    """The least of what nothing makes, and of time, that would have to be added; empty where that does not help."""
    made = {name for each in problem.activities for name in each.makes}
    program = _Program(problem, 1, is_ordered=False, free=tuple(n for n in problem.resources if n not in made))
    values = program.solve(np.repeat([0.0, 1.0], [program.size, program.width - program.size]))
    if values is None:
        return Shortage()
    added = zip(program.free, values[program.size : -1], strict=True)
    short = {name: float(np.ceil(amount / problem.units.get(name, 1) - _SLACK)) for name, amount in added}
    return Shortage(short={name: amount for name, amount in short.items() if amount > 0}, short_s=float(values[-1]))


class _Program:
    """The integer program of some rounds.

    Columns: of each round how often each activity is applied, whether it is, and how much of each resource is there
    afterwards; then what is added of the `free` ones, and of time. Not `is_ordered`, the one round stands for all of
    them in any order.
    """

    def __init__(
        self,
        problem: AmountProblem,
        rounds: int,
        *,
        is_ordered: bool = True,
        free: tuple[Resource, ...] | None = None,
        nodes_max: int = NODES_MAX,
    ) -> None:
        self.nodes, self._nodes_max = 0, nodes_max
        self.is_cut_short = False  # by time
        self.problem, self.rounds, self.free, self._is_ordered = problem, rounds, free or (), is_ordered
        self._resources = problem.resources
        self._times_max = TIMES_MAX if is_ordered else PROOF_TIMES_MAX
        count = len(problem.activities)
        self._used_at = rounds * count
        self._amounts_at = 2 * rounds * count
        self.size = self._amounts_at + rounds * len(self._resources)
        self.width = self.size + len(self.free) + 1
        self._more_s = 0.0 if free is None else np.inf
        self._rows: list[tuple[dict[int, float], float, float]] = []
        for index in range(rounds):
            self._add_round(index)
        self._add_limits()

    def _times(self, index: int) -> Iterator[tuple[int, int, Activity]]:
        """Columns of how often, and whether, each activity is applied in a round."""
        at = index * len(self.problem.activities)
        return ((at + i, self._used_at + at + i, each) for i, each in enumerate(self.problem.activities))

    def _amount(self, index: int, name: Resource) -> tuple[dict[int, float], float]:
        """What is there after a round, as a sum of columns and a constant."""
        if index < 0:
            slack = {self.size + self.free.index(name): 1.0} if name in self.free else {}
            return slack, self.problem.initial.get(name, 0.0)
        return {self._amounts_at + index * len(self._resources) + self._resources.index(name): 1.0}, 0.0

    def _add(self, sums: Mapping[int, float], least: float, most: float) -> None:
        self._rows.append((dict(sums), least, most))

    def _add_round(self, index: int) -> None:
        least = self.problem.least
        for times, used, _ in self._times(index):
            self._add({times: 1.0, used: -self._times_max}, -np.inf, 0.0)
        for name in self._resources:
            before, given = self._amount(index - 1, name)
            after, _ = self._amount(index, name)
            column = {
                times: (each.makes.get(name, 0.0), each.uses.get(name, 0.0)) for times, _, each in self._times(index)
            }
            change = {times: uses - makes for times, (makes, uses) in column.items() if makes != uses}
            minus = {key: -value for key, value in before.items()}
            self._add(after | minus | change, -np.inf if name in self.problem.most else given, given)
            # what must be there: all of it before the round, or, in any order, whatever there ever is
            taken = {times: uses if self._is_ordered else -makes for times, (makes, uses) in column.items()}
            taken = {times: value for times, value in taken.items() if value}
            if self._is_ordered and taken:
                self._add(taken | minus, -np.inf, given - least.get(name, 0.0))
            for _, used, each in self._times(index):
                if need := each.needs.get(name):
                    self._add({used: need} | taken | minus, -np.inf, given)

    def _add_limits(self) -> None:
        each = [(times, used, a) for index in range(self.rounds) for times, used, a in self._times(index)]
        if (time_s := self.problem.time_s) is not None:
            self._add({times: a.time_s for times, _, a in each} | {self.width - 1: -1.0}, -np.inf, time_s)
        if self.problem.sessions is not None:
            self._add({used: 1.0 for _, used, _ in each}, -np.inf, self.problem.sessions)

    def _list_bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        least, most = np.zeros(self.width), np.full(self.width, np.inf)
        most[-1] = self._more_s
        most[: self._used_at], most[self._used_at : self._amounts_at] = self._times_max, 1.0
        for index in range(self.rounds):
            for name in self._resources:
                (column,) = self._amount(index, name)[0]
                least[column] = self.problem.least.get(name, 0.0)
                most[column] = self.problem.most.get(name, np.inf)
        for column, (low, high) in self._iter_goals():
            least[column], most[column] = max(least[column], low), min(most[column], high)
        return least, most

    def _iter_goals(self) -> Iterator[tuple[int, tuple[float, float]]]:
        """Columns that a stage bounds: at the end of its share of the rounds; in any order the end alone."""
        stages = self.problem.stages
        for number, stage in enumerate(stages, 1):
            if self._is_ordered or number == len(stages):
                for name, bounds in stage.items():
                    (column,) = self._amount(self._find_end(number) - 1, name)[0]
                    yield column, bounds

    def _find_end(self, number: int) -> int:
        """After how many rounds a stage is reached."""
        return self.rounds * number // len(self.problem.stages)

    def _run(self, costs: NDArray[np.float64]) -> tuple[int, NDArray[np.float64] | None]:
        """How HiGHS ended, and the values of all columns."""
        from scipy.optimize import Bounds as Limits
        from scipy.optimize import LinearConstraint, milp
        from scipy.sparse import coo_array

        entries = [
            (row, column, value) for row, (sums, _, _) in enumerate(self._rows) for column, value in sums.items()
        ]
        rows, columns, values = (np.array(each) for each in zip(*entries, strict=True))
        matrix = coo_array((values, (rows, columns)), shape=(len(self._rows), self.width)).tocsc()
        limits = LinearConstraint(matrix, [low for _, low, _ in self._rows], [high for *_, high in self._rows])
        whole = np.zeros(self.width, dtype=np.int64)
        whole[: self._amounts_at] = 1
        with _divert_stdout():
            found = milp(
                costs,
                integrality=whole,
                bounds=Limits(*self._list_bounds()),
                constraints=limits,
                options={"mip_rel_gap": GAP, "node_limit": self._nodes_max, "time_limit": LONG_S},
            )
        self.nodes = found.mip_node_count or 0
        self.is_cut_short = found.status == _AT_LIMIT and self.nodes < self._nodes_max
        return found.status, found.x

    def solve(self, costs: NDArray[np.float64]) -> NDArray[np.float64] | None:
        """The values of all columns at least cost; None without any."""
        return self._run(costs)[1]

    def is_infeasible(self) -> bool:
        """Whether no values fit."""
        return self._run(np.zeros(self.width))[0] == _INFEASIBLE

    def find_plan(self) -> AmountPlan | None:
        """A plan of these rounds, carried out by exact arithmetic; None where none was found."""
        costs = np.zeros(self.width)
        for index in range(self.rounds):
            for times, used, each in self._times(index):
                costs[times], costs[used] = each.time_s, SESSION_S
        if (values := self.solve(costs)) is None:
            return None
        batches: list[Batch] = []
        ends = [self._find_end(number) for number in range(1, len(self.problem.stages) + 1)]
        reached = [0] * len(ends)
        for index in range(self.rounds):
            chosen = [(round(values[times]), each) for times, _, each in self._times(index) if values[times] > 0.5]
            chosen.sort(key=lambda pair: any(name in self.problem.most for name in pair[1].makes))
            batches += [Batch(each, times) for times, each in chosen]
            reached = [len(batches) if end > index else before for before, end in zip(reached, ends, strict=True)]
        plan = AmountPlan(tuple(batches), tuple(reached))
        return plan if is_valid(self.problem, plan) else None


def is_valid(problem: AmountProblem, plan: AmountPlan) -> bool:
    """Whether each batch can be carried out where it stands, no resource falls too low, and each stage is reached."""
    states = [*iter_amounts(problem, plan.batches)]
    for batch, state in zip(plan.batches, states, strict=False):
        each = batch.activity
        for name in each.needs.keys() | each.uses.keys():
            floor = max(problem.least.get(name, 0.0), each.needs.get(name, 0.0))
            if state.get(name, 0.0) - batch.times * each.uses.get(name, 0.0) < floor - _SLACK:
                return False
    ends = [(states[reached], stage) for reached, stage in zip(plan.reached, problem.stages, strict=True)]
    return all(low - _SLACK <= s.get(name, 0.0) <= high + _SLACK for s, g in ends for name, (low, high) in g.items())


@contextmanager
def _divert_stdout() -> Iterator[None]:
    """HiGHS 1.12 prints a line of its own where it repairs a solution: to stderr, as stdout may carry JSON."""
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
