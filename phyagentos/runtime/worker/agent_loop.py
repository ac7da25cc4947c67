"""A session that an agent directs, call by call; its tools are skills with a tree. Paper section 4.1.

Each call is checked as a session would be: name and arguments, objects that are there, preconditions. The set-points of
a tool go through the guard like any others; whatever the agent claims at the end, the verdict rests on the evidence.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec
from py_trees.common import Status

from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, raise_any
from phyagentos.protocol.capabilities.skill_runtimes import AgentCall, AgentLoop
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime as Skill
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Located, validate
from phyagentos.protocol.predicates.predicate import Evaluation, parse_predicate, substitute
from phyagentos.protocol.sessions.agent_calls import CallFiles, Turn
from phyagentos.protocol.sessions.trace import Role, TraceEvent
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.execution.context import SkillContext
from phyagentos.runtime.execution.skill_runtime import Failure, SkillRuntime, SkillStatus, TickResult
from phyagentos.runtime.perception.world_model import WORLD
from phyagentos.runtime.preflight.adapter_plan import describe_skill_tool
from phyagentos.runtime.preflight.arguments import (
    iter_name_problems,
    iter_parameter_problems,
    iter_precondition_problems,
)

LEAF = "agent"


@dataclass(slots=True, kw_only=True)
class AgentLoopRuntime:
    """A `SkillRuntime` whose next step an agent chooses: the procedure of its skill, else one of another process."""

    loop: AgentLoop
    tools: Mapping[str, Skill]
    context: SkillContext
    open_tree: Callable[[str, SkillContext], SkillRuntime]
    files: CallFiles
    clock: Clock
    _tool: SkillRuntime | None = None
    _events: list[TraceEvent] = field(default_factory=list)
    _failure: Failure | None = None
    _is_over: bool = False
    _turn: int = 1
    _shown: int = 0
    _commands: int = 0
    _begun: int = 0  # commands before the present tool
    _hold_until_s: float = 0.0
    _result: Fields = field(default_factory=dict)
    _outputs: Fields = field(default_factory=dict)
    _steps: Iterator[AgentCall] = field(init=False)

    def __post_init__(self) -> None:
        self._steps = iter(self.loop.procedure)

    def tick(self) -> TickResult:
        """Go on with the tool that runs, or take the agent's next decision."""
        if self._tool is not None:
            result = self._tool.tick()
            self._commands += result.set_points is not None
            if result.status is SkillStatus.RUNNING:
                return result
            self._end_tool(self._tool)
        if self.context.time_s < self._hold_until_s:
            self.context.commands.hold()
            self._commands += 1
            return TickResult(SkillStatus.RUNNING, self.context.commands.take(), LEAF)
        if self._turn > self.loop.calls and not self._is_over:
            self._fail("BUDGET", f"{self.loop.calls} calls were made, and the agent did not finish")
        if self._is_over:
            return TickResult(SkillStatus.SUCCEEDED if self._failure is None else SkillStatus.FAILED, None, LEAF)
        if (given := self._decide()) is None:
            return TickResult(SkillStatus.RUNNING, None, LEAF, thinking=True)
        self._result = self._carry_out(given)
        self._turn += 1
        return TickResult(SkillStatus.RUNNING, None, LEAF)

    def wait(self, timeout_s: float) -> None:
        """Sleep until the tool's planner, or the agent, may have answered."""
        self._tool.wait(timeout_s) if self._tool is not None else self.clock.sleep(timeout_s)

    def halt(self) -> None:
        """Interrupt the tool that runs."""
        if self._tool is not None:
            self._tool.halt()
            self._end_tool(self._tool)

    def read_outputs(self) -> Fields:
        """Outputs of the tools; the latest of each name."""
        return self._outputs

    def find_failure(self) -> Failure | None:
        """Why the agent gave up, or could not go on."""
        return self._failure

    def trace(self) -> tuple[TraceEvent, ...]:
        """Each call or its refusal, followed by the leaves of its tool."""
        return tuple(self._events)

    def close(self) -> None:
        """Nothing is left open: a tool is closed where it ends."""

    def _decide(self) -> Any:
        """The next call as plain data, None while it is awaited."""
        session = self.context.session
        if not self.loop.procedure:
            if self._turn != self._shown:
                self._shown = self._turn
                turn = Turn(
                    turn=self._turn,
                    objective=session.objective,
                    accept=session.accept,
                    calls_left=self.loop.calls - self._turn + 1,
                    time_s=self.context.time_s,
                    tools=tuple(msgspec.to_builtins(describe_skill_tool(each)) for each in self.tools.values()),
                    result=self._result,
                )
                self.files.show(turn)
            return self.files.find_answer(self._turn)
        for step in self._steps:
            given = _fill(step.model_dump(mode="json"), session.parameters)
            if not given["when"] or self._evaluate(given["when"]).truth is Truth.TRUE:
                return given
        return {"call": "finish", "reason": "the procedure is at its end"}

    def _carry_out(self, given: Any) -> Fields:
        """Check a call and begin it; what it says at once, or why it is refused."""
        try:
            call = validate(AgentCall, Located(given, f"turn {self._turn}"))
            self._note(Status.RUNNING, call.reason, call=call.model_dump(mode="json", exclude_defaults=True))
            return self._begin(call)
        except DefinitionError as error:
            self._note(Status.FAILURE, str(error), code=error.problems[0].code)
            return {"ended": "refused", "problems": msgspec.to_builtins(error.problems)}

    def _begin(self, call: AgentCall) -> Fields:
        match call.call:
            case "observe":
                return {"ended": "done", "world": self._describe_world()}
            case "query_state":
                found = self._evaluate(call.predicate)
                return {"ended": "done", "truth": found.truth.value, "because": found.because}
            case "wait":
                self._hold_until_s = self.context.time_s + call.seconds
            case "invoke_tool":
                self._invoke(call)
            case "finish" if call.claim == "failure":
                self._fail("AGENT_GAVE_UP", call.reason or "the agent gave up")
            case "finish":
                self._is_over = True
        return {"ended": "done"}

    def _invoke(self, call: AgentCall) -> None:
        """Begin a tool whose call has no problem."""
        if call.tool not in self.tools:
            raise DefinitionError.unknown("tool", f"turn {self._turn}: tool", call.tool, self.tools)
        skill, session = self.tools[call.tool], self.context.session
        defaults = {name: each.default for name, each in skill.parameters.items() if each.default is not None}
        values = {**defaults, **call.arguments}
        session = msgspec.structs.replace(
            session,
            skill=skill.skill,
            parameters=values,
            requires=tuple(substitute(text, {**values, "target": session.target}) for text in skill.requires),
            hold=(),
            accept=(),
        )
        if not (problems := list(iter_parameter_problems(session, skill))):
            now = self.context.world.observe(WORLD)
            names = iter_name_problems(session, skill, now, is_fresh=False)
            problems = [*names, *iter_precondition_problems(session, now)]
        raise_any(problems)
        self._tool, self._begun = self.open_tree(skill.tree, replace(self.context, session=session)), self._commands

    def _end_tool(self, tool: SkillRuntime) -> None:
        failure, outputs, self._tool = tool.find_failure(), tool.read_outputs(), None
        self._events += [msgspec.structs.replace(each, tick=each.tick + self._begun) for each in tool.trace()]
        tool.close()
        self._outputs |= outputs
        self._result = {"ended": "done", "outputs": outputs}
        if failure is not None:
            self._result = {"ended": "failed", "code": failure.code, "message": failure.message}

    def _evaluate(self, text: str) -> Evaluation:
        view = self.context.session.make_view(self.context.world.observe(WORLD), self.context.initial)
        return parse_predicate(text).evaluate(view)

    def _describe_world(self) -> Fields:
        """The world as perceived: objects with their positions [m], what is held, and what no look has shown."""
        now = self.context.world.observe(WORLD)
        objects = {
            name: {"kind": each.kind, "position_m": [round(value, 4) for value in each.pose.position_m]}
            for name, each in now.entities.items()
        }
        holding = now.targets[self.context.session.target].holding
        facts = {"sensing": now.sensing, "things": objects, "regions": list(now.regions)}
        return {**facts, "holding": list(holding), "never_seen": list(now.never_seen)}

    def _fail(self, code: str, message: str) -> None:
        self._is_over, self._failure = True, Failure(LEAF, code, message)
        self._note(Status.FAILURE, message, code=code)

    def _note(self, status: Status, message: str, *, code: str = "", **numbers: Any) -> None:
        event = TraceEvent(
            tick=self._commands,
            time_s=self.context.time_s,
            path=LEAF,
            leaf=LEAF,
            status=status.value,
            declared_role=Role.DECIDE,
            code=code,
            message=message,
            numbers={"turn": self._turn, **numbers},
        )
        self._events.append(event)


def _fill(value: Any, parameters: Mapping[str, Any]) -> Any:
    """Plain data with the session's parameters for `${name}`; a text that is nothing else becomes the value itself."""
    if isinstance(value, dict):
        return {key: _fill(each, parameters) for key, each in value.items()}
    if isinstance(value, str) and value.startswith("${") and value[2:-1] in parameters:
        return parameters[value[2:-1]]
    return substitute(value, parameters) if isinstance(value, str) else value
