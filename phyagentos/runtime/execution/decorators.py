"""Decorators of the tree format, and the predicate as a leaf."""

from collections.abc import Callable, Mapping

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.decorators import Decorator

from phyagentos.protocol.sessions.trace import Role
from phyagentos.protocol.world.predicates.predicate import View, parse_predicate, substitute
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.execution.context import SkillContext
from phyagentos.runtime.execution.leaf import FailureCode, Leaf
from phyagentos.runtime.perception.world_model import BELIEF


class SimulatedTimeout(Decorator):
    """Fails when the child runs longer than so many seconds of simulated time; planning costs none."""

    def __init__(self, name: str, child: Behaviour, seconds: float, context: SkillContext) -> None:
        super().__init__(name=name, child=child)
        self._seconds = seconds
        self._context = context
        self._began_s = 0.0
        self.code = ""
        self.message = ""

    def initialise(self) -> None:
        """Store the start time."""
        self._began_s = self._context.time_s
        self.code, self.message = "", ""

    def update(self) -> Status:
        """The child's status, or FAILURE when time is up."""
        elapsed_s = self._context.time_s - self._began_s
        if self.decorated.status is Status.RUNNING and elapsed_s >= self._seconds:
            self.code = FailureCode.OUT_OF_TIME
            self.message = f"{self.decorated.name} still ran after {elapsed_s:.2f} s (limit {self._seconds} s)"
            return Status.FAILURE
        return self.decorated.status


class Condition(Leaf):
    """Evaluates a predicate on the present world; unknown is never success.

    `text` is the predicate, with `${key}` for keys of the tree, whose values `read_keys` gives.
    """

    ROLE = Role.DECIDE

    def __init__(
        self, name: str, context: SkillContext, path: str, text: str, read_keys: Callable[[], Mapping[str, object]]
    ) -> None:
        super().__init__(name, context, path)
        self._text = text
        self._read_keys = read_keys

    def on_start(self) -> Status:
        """Substitute, parse, evaluate."""
        target = self.context.session.target
        text = substitute(self._text, self._read_keys())
        view = View(now=self.context.world.observe(BELIEF), initial=self.context.initial, target=target)
        evaluation = parse_predicate(text).evaluate(view)
        if evaluation.truth is Truth.TRUE:
            return self.succeed(text)
        return self.fail(FailureCode.UNMET, f"{text} is {evaluation.truth}: {evaluation.because}")
