"""A verified sequence of sessions as a skill of its own: SKILL.md, its tree, and a goal that tries it on known starts.

The tree is made of the trees of its steps. What the first steps act on are further parameters, named after their skill.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from phyagentos.agent.memory.episodes import Episode
from phyagentos.agent.memory.experience_log import Event
from phyagentos.agent.memory.memory import find_seq
from phyagentos.agent.memory.methodological import Correction
from phyagentos.agent.memory.semantic import Rank
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.skill_runtimes import Learned, SkillRuntime
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.predicates.predicate import substitute
from phyagentos.protocol.sessions.memory_entries import EntryState

Start = tuple[Episode, ...]  # sessions of one start on which a sequence was verified; the last one is the attempt
Step = tuple[SkillRuntime, Mapping[str, str]]  # a skill, and the name in the whole of each of its parameters


@dataclass(frozen=True, slots=True)
class Composition:
    """A skill, and the steps that it is made of."""

    skill: SkillRuntime
    steps: tuple[Step, ...]

    def render_skill(self) -> str:
        """SKILL.md, which says where it comes from."""
        title = self.skill.skill.replace("_", " ").capitalize()
        front = self.skill.model_dump(mode="json", exclude_defaults=True)
        return f"---\n{_render(front)}---\n\n# {title}\n\n{self.skill.description} Learned; see `learned` above.\n"

    def render_tree(self) -> str:
        """Its tree: the trees of its steps, one after the other."""
        of_port = {"type", "description", "optional", "default"}
        inputs = {
            name: each.model_dump(mode="json", include=of_port, exclude_defaults=True)
            for name, each in self.skill.parameters.items()
        }
        wirings = [{key: f"${name}" for key, name in names.items()} for _, names in self.steps]
        wirings[-1] |= {key: f"${key}" for key in self.skill.outputs}
        children = [
            {"subtree": {"name": f"step_{index}", "tree": skill.tree, "with": wiring}}
            for index, ((skill, _), wiring) in enumerate(zip(self.steps, wirings, strict=True), 1)
        ]
        outputs = {name: each.model_dump(exclude_defaults=True) for name, each in self.skill.outputs.items()}
        head = {"tree": self.skill.tree, "description": self.skill.description, "inputs": inputs, "outputs": outputs}
        return _render(head | {"root": {"sequence": {"children": children}}})

    def render_goal(self, start: Start) -> str:
        """A goal graph that tries the skill on a start."""
        given = {
            name: episode.parameters[key]
            for (_, names), episode in zip(self.steps, start, strict=True)
            for key, name in names.items()
            if key in episode.parameters
        }
        name, attempt = self.skill.skill, start[-1]
        goal: Fields = {"goal": name, "objective": "Try it on a start that is known.", "scene": attempt.scene}
        goal |= {"targets": {"robot": attempt.target}, "defaults": {"max_replans": 0}}
        return _render(goal | {"sessions": {"try": {"skill": name, "target": "robot", "with": given}}})


def find_starts(lesson: Correction, events: Iterable[Event]) -> list[Start]:
    """The starts on which first attempts that the lesson advised succeeded, each once, the oldest first."""
    episodes = {(each.begun, each.session): each for each in events if isinstance(each, Episode)}
    starts: dict[int, Start] = {}
    for attempt in episodes.values():
        if lesson.id not in attempt.advised_by or not (attempt.is_first and attempt.is_success):
            continue
        before: list[Episode] = []
        each = episodes.get((attempt.begun, attempt.parent or ""))
        while each is not None:
            before.insert(0, each)
            each = episodes.get((each.begun, each.parent or ""))
        done = [each for each in before if each.is_success and each.purpose != "inspect"]
        if [each.skill for each in done] == [each.skill for each in lesson.means.prepare]:
            starts.setdefault(attempt.seed, (*done, attempt))
    return list(starts.values())


def compose(
    name: str, lesson: Correction, skills: Mapping[str, SkillRuntime], starts: Sequence[Start], *, memory: str
) -> Composition:
    """The skill of this name that a lesson has proved on some starts, as a snapshot of `memory` knows it.

    Raises:
        DefinitionError: `NOT_PERMITTED`: the lesson is no sequence, does not count, or its test is not decided for it.
    """
    _check(lesson, skills, find_seq(memory))
    last = skills[lesson.means.skill or lesson.scope.skill]
    steps: list[Step] = []
    for index, preparation in enumerate(lesson.means.prepare):
        skill = skills[preparation.skill]
        shared = last.parameters if not preparation.kind else {}
        prefix = f"{skill.skill}{index + 1 if index else ''}"
        steps.append((skill, {key: key if key in shared else f"{prefix}_{key}" for key in skill.parameters}))
    before = " and ".join(skill.skill for skill, _ in steps)
    steps.append((last, {key: key for key in last.parameters}))
    needs: Fields = {}
    for skill, _ in steps:
        for key, values in skill.needs.model_dump(exclude={"phyagentos"}).items():
            needs[key] = tuple(dict.fromkeys((*needs.get(key, ()), *values)))
    attempts = [start[-1] for start in starts]
    seeds, sessions = tuple(each.seed for each in attempts), tuple(each.session for each in attempts)
    composed = SkillRuntime(
        skill=name,
        description=f"{last.description.rstrip('.')}, after {before}.",
        tree=name,
        parameters={of_whole: skill.parameters[key] for skill, names in steps for key, of_whole in names.items()},
        outputs=last.outputs,
        requires=_collect(steps, "requires"),
        hold=_collect(steps, "hold"),
        guarantees=last.guarantees,
        needs=type(last.needs)(**needs),
        learned=Learned(entry=lesson.id, memory=memory, rate=str(lesson.applied), sessions=sessions, seeds=seeds),
    )
    return Composition(composed, tuple(steps))


def _check(lesson: Correction, skills: Mapping[str, SkillRuntime], seq: int) -> None:
    state, why = lesson.judge(seq)
    names = [*(each.skill for each in lesson.means.prepare), lesson.means.skill or lesson.scope.skill]
    strangers = [each for each in names if each not in skills or skills[each].kind != "builtin"]
    if lesson.means.prepare and not strangers and state is EntryState.ACTIVE and lesson.trial.rank is Rank.PROMOTED:
        return
    found = f"{state} {why}; {lesson.trial.rank} after {lesson.applied} first attempts"
    found += f"; no tree carries out {strangers[0]}" if strangers else "" if lesson.means.prepare else "; one session"
    expected = "a lesson in force with something that comes first, promoted by the test of first attempts"
    raise DefinitionError.of("NOT_PERMITTED", lesson.id, found, expected, "Let it advise more runs, on other seeds.")


def _collect(steps: Sequence[Step], what: str) -> tuple[str, ...]:
    found: dict[str, None] = {}
    for skill, names in steps:
        renamed = {key: f"${{{name}}}" for key, name in names.items()}
        found |= dict.fromkeys(substitute(text, renamed) for text in getattr(skill, what))
    return tuple(found)


def _render(data: Any) -> str:
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=118)
