"""An agent in ScienceWorld as a body without joints: the actions of its world, and skills made of them, as tools.

    python -m scienceworld_body < KEY

A scene is a task of the environment and a seed one of its variations: both say only how the world begins. What is
reported is what the text says: what is carried, what is in view, and what was measured. The environment's score stays
in this process, and is an outcome when a session ends.
"""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from string import Formatter
from typing import Any

from scienceworld import ScienceWorldEnv
from target_server.body import State, append_outcome
from target_server.tool_body import Steps, Tool, ToolBody
from target_server.wire import Refusal

from scienceworld_body import circuits, errands, garden, laboratory
from scienceworld_body.agent import Agent, spell
from scienceworld_body.reading import CARRIED

HOUSE = "house"  # as the first task has it, for goals that are no task
ACTIONS = {
    "look_at": "look at {what}", "open": "open {what}", "close": "close {what}", "pick_up": "pick up {what}",
    "put_down": "put down {what}", "activate": "activate {what}", "deactivate": "deactivate {what}",
    "read": "read {what}", "focus": "focus on {what}", "stir": "mix {what}", "eat": "eat {what}",
    "go": "go to {what}", "move": "move {what} to {to}", "pour": "pour {what} into {to}",
    "dunk": "dunk {what} into {to}", "flush": "flush {what}",
    "look": "look around", "wait": "wait1", "use": "use {what} on {to}",
    "connect": "connect {what} to {to}", "disconnect": "disconnect {what}",
}  # fmt: skip
"""The environment's own actions by the tool that does them, in its words."""
SKILLS = (
    errands.attend, errands.fetch, errands.bring, errands.attend_stages, errands.attend_lifespan,
    laboratory.hold, laboratory.change, laboratory.measure, laboratory.find_melting_point, laboratory.mix,
    laboratory.compare_slopes, circuits.power, circuits.try_conductor, garden.sow, garden.grow, garden.harvest,
    garden.cross,
)  # fmt: skip
TYPES = {str: "string", int: "integer"}
STEP_LIMIT = 1_000_000  # none: a session's time limits it
WHOLE = 100  # the score of a task that is done


class ScienceBody(ToolBody[str]):
    """One world. It goes on when the agent acts, and not otherwise."""

    target, driver, step_s, has_truth = "scientist", "scienceworld", 0.1, True

    def __init__(self) -> None:
        self._env = ScienceWorldEnv("", envStepLimit=STEP_LIMIT)
        self._agent = Agent(self._env.server)
        self._task, self._variation, self._history, self._steps = "", 0, list[str](), 0
        self.toolbox: Mapping[str, Tool[str]] = {
            **{name: self._offer(words) for name, words in ACTIONS.items()},
            **{skill.__name__: self._bind(skill) for skill in SKILLS},
        }

    def _offer(self, words: str) -> Tool[str]:
        arguments = {field: "string" for _, field, _, _ in Formatter().parse(words) if field}
        return Tool(
            lambda **given: self._agent.do(words.format(**{name: _read_word(each) for name, each in given.items()})),
            arguments,
        )

    def _bind(self, skill: Callable[..., Steps[str]]) -> Tool[str]:
        _, *parameters = signature(skill).parameters.values()
        return Tool(
            lambda **given: skill(self._agent, **{name: _read_word(each) for name, each in given.items()}),
            {each.name: TYPES[each.annotation] for each in parameters},
        )

    @property
    def time_s(self) -> float:
        return self._steps * self.step_s

    def load(self, scene: str, seed: int, snapshot: bytes) -> None:
        actions: Sequence[str] = ()
        notes: Sequence[dict[str, Any]] = ()
        steps = 0
        if snapshot:
            try:
                scene, seed, actions, steps, notes = json.loads(snapshot)
            except ValueError as error:
                raise Refusal("MALFORMED", f"no snapshot of ScienceWorld: {error}") from error
        known = self._env.get_task_names()
        if scene not in (HOUSE, *known):
            raise Refusal("MALFORMED", f"no scene {scene!r} in ScienceWorld")
        self._task, self._variation, self._history, self._steps = scene, seed, [], 0
        self._env.load(known[0] if scene == HOUSE else scene, seed, "")
        self._env.server.reset()
        self._env.server.step("look around")  # the first move of its own `reset`: the score is of this world now
        self._agent.begin()
        for action in actions:
            self.act(action)
        self._steps = steps
        if notes:
            self._agent.facts, self._agent.names, self._agent.filled = notes

    def snapshot(self) -> tuple[str, bytes]:
        """The scene, the seed, every action since, which give the same world again; its time, and the agent's notes."""
        notes = self._agent.facts, self._agent.names, self._agent.filled
        return "application/json", json.dumps((self._task, self._variation, self._history, self._steps, notes)).encode()

    def act(self, action: str | None) -> None:
        self._steps += 1
        if action is not None:
            self._history.append(action)
            self._agent.act(action)
            self._env.server.getScore()  # as its own `step` does: sub-goals count when they are looked for

    def read(self) -> State:
        """What is carried and what is in view, by name; counts of what was put into boxes; what was measured."""
        seen = self._agent.room.seen
        carried = Counter(name_item(each.name) for each in seen if CARRIED in each.inside)
        boxed = {f"in_{name_item(each)}": float(n) for each, n in self._agent.filled.items()}
        return State(
            inventory=dict(carried),
            vitals={**self._agent.facts, **boxed},
            nearby=tuple(sorted({name_item(each.name) for each in seen} | {name_item(self._agent.room.name)})),
        )

    def note_end(self, session: str) -> None:
        """The environment's own score, for who measures."""
        score = round(100 * self._env.server.getScore())
        world = {"task": self._task, "variation": self._variation, "actions": len(self._history)}
        append_outcome(session, success=score == WHOLE, score=score, **world)

    def close(self) -> None:
        self._env.close()


def name_item(name: str) -> str:
    """A name of the text as one word."""
    return "_".join(spell(name).split())


def _read_word(value: str | int) -> str | int:
    """An argument as the text has it."""
    return value.replace("_", " ") if isinstance(value, str) else value
