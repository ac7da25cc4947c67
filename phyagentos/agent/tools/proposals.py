"""Proposed goals: files in `proposals/new/` of a workspace, and the decisions on them, which bind their bytes.

A proposal is named after the SHA-256 of its bytes, so a changed file no longer has its own name. That name is also the
id of its goal: the journal takes a goal once, so no approval can be used twice. A decision is a file of the operator's
side in `proposals/decisions/`; no tool writes there, and nothing starts a robot because a file appears there. Without a
person, a policy file of the operator decides: it permits goals within bounds.
"""

import contextlib
import hashlib
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import pydantic
import yaml

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph
from phyagentos.agent.goals.spec import NODE_NAME
from phyagentos.errors import DefinitionError, Problem, format_names
from phyagentos.protocol.documents.durable_files import create_durably
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.regular_files import read_regular
from phyagentos.protocol.documents.schema import Authored, ModelT, iter_nested, parse_yaml, validate
from phyagentos.protocol.documents.seen_text import find_unseen
from phyagentos.protocol.sessions.session import GoalId

PROPOSAL_MAX = 1 << 18  # bytes
WAITING_MAX = 100  # proposals without a decision; a person reads no more
_TIME = r"^([01]\d|2[0-3]):[0-5]\d$"
_NAME = re.compile(r"[a-z][a-z0-9_]{0,79}-[0-9a-f]{16}")


class Proposal(Authored):
    """A goal that is asked for from outside, by whom, and who decides; overrides are applied, graphs included."""

    proposal: Literal[1] = 1
    goal: str = pydantic.Field(pattern=NODE_NAME, max_length=80)
    seed: int = pydantic.Field(ge=0, lt=2**63)
    by: str = pydantic.Field(max_length=80)
    at: str = pydantic.Field(max_length=40)
    reason: str = pydantic.Field(default="", max_length=2000)
    decider: Literal["person", "policy"] = "person"
    graph: Fields


class Decision(Authored):
    """What was decided on a proposal, by a user of this machine or a policy file, named with its SHA-256."""

    decision: Literal["approved", "denied"]
    proposal: str
    sha256: str
    by: str
    at: str
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Proposed:
    """A proposal as it stands on the disk: its name, its own bytes with their SHA-256, and what they say."""

    name: GoalId
    data: bytes
    sha256: str
    proposal: Proposal


def encode_proposal(proposal: Proposal) -> Proposed:
    """The canonical bytes of a proposal, and the name that they give it; raises `TOO_LARGE` or `INVALID_VALUE`."""
    content = proposal.model_dump(mode="json")
    texts = (text for text in iter_nested(content) if isinstance(text, str))
    if hidden := sorted({each for text in texts for each in find_unseen(text)}):
        expected = "text that is seen as it is"
        raise DefinitionError.of("INVALID_VALUE", proposal.goal, ", ".join(hidden[:8]), expected)
    data = _dump(proposal)
    if len(data) > PROPOSAL_MAX:
        raise DefinitionError.of("TOO_LARGE", proposal.goal, f"{len(data)} bytes", f"at most {PROPOSAL_MAX}")
    digest = hashlib.sha256(data).hexdigest()
    return Proposed(GoalId(f"{proposal.goal}-{digest[:16]}"), data, digest, proposal)


class Proposals:
    """The folder `proposals/` of a workspace."""

    def __init__(self, folder: Path) -> None:
        self._new, self._decisions = folder / "new", folder / "decisions"

    def put(self, proposed: Proposed) -> None:
        """Write a proposal; raises DefinitionError `TOO_LARGE`."""
        if len(waiting := self.list_waiting()) >= WAITING_MAX:
            raise DefinitionError.of("TOO_LARGE", proposed.name, f"{len(waiting)} wait", "decisions on them")
        create_durably(self._new / f"{proposed.name}.yaml", proposed.data)

    def list_waiting(self) -> list[str]:
        """Names of proposals without a decision, oldest file first."""
        files = [path for path in self._new.glob("*.yaml") if not path.is_symlink() and _NAME.fullmatch(path.stem)]
        waiting = [path for path in files if not os.path.lexists(self._decisions / path.name)]
        return [path.stem for path in sorted(waiting, key=lambda path: (path.lstat().st_mtime_ns, path.name))]

    def iter_readable(self) -> Iterator[Proposed]:
        """What waits and is as it was written; `paos approve` lists the others with what is wrong."""
        for name in self.list_waiting():
            with contextlib.suppress(DefinitionError):
                yield self.read(name)

    def has(self, name: str) -> bool:
        """Whether a proposal is called so."""
        return _NAME.fullmatch(name) is not None and os.path.lexists(self._new / f"{name}.yaml")

    def read(self, name: str) -> Proposed:
        """One proposal; its bytes are read once, and everything that follows is about these.

        Raises DefinitionError `UNKNOWN_NAME`; `CHANGED` unless they are those that its name stands for.
        """
        if not self.has(name):
            raise DefinitionError.unknown("proposal", str(self._new), name[:100], self.list_waiting())
        proposal, data = _read(self._new / f"{name}.yaml", Proposal)
        proposed = encode_proposal(proposal)
        if proposed.data != data or proposed.name != name:
            expected = "the bytes that its name stands for"
            raise DefinitionError.of("CHANGED", name, "other bytes", expected, "Propose it again.")
        return proposed

    def decide(
        self, proposed: Proposed, decision: Literal["approved", "denied"], *, by: str, at: str, reason: str
    ) -> None:
        """Write the decision on a proposal; the first one stays: raises DefinitionError `ALREADY_OVER`."""
        facts = Decision(decision=decision, proposal=proposed.name, sha256=proposed.sha256, by=by, at=at, reason=reason)
        if not create_durably(self._decisions / f"{proposed.name}.yaml", _dump(facts)):
            raise DefinitionError.of("ALREADY_OVER", proposed.name, "another decision", "the first one stays")

    def find_decision(self, proposed: Proposed) -> Decision | None:
        """The decision on exactly these bytes, None while it waits; raises DefinitionError `CHANGED`."""
        path = self._decisions / f"{proposed.name}.yaml"
        if not os.path.lexists(path):
            return None
        decision, _ = _read(path, Decision)
        if (decision.proposal, decision.sha256) != (proposed.name, proposed.sha256):
            expected = f"a decision on {proposed.sha256}"
            raise DefinitionError.of("CHANGED", str(path), f"one on {decision.sha256}", expected)
        return decision

    def count_approvals(self, by: str, since: str) -> int:
        """Approvals of one decider since a wall time."""
        found = [_read(path, Decision)[0] for path in self._decisions.glob("*.yaml")]
        return sum(each.decision == "approved" and each.by == by and each.at >= since for each in found)


def _read(path: Path, model: type[ModelT]) -> tuple[ModelT, bytes]:
    try:
        data = read_regular(path, PROPOSAL_MAX, follow=False)
        return validate(model, parse_yaml(data.decode(), path.name)), data
    except (OSError, UnicodeDecodeError) as error:
        raise DefinitionError.of("UNREADABLE_FILE", str(path), str(error)) from error


def _dump(value: Authored) -> bytes:
    """YAML for people and for hashes: the same values give the same bytes."""
    return yaml.safe_dump(value.model_dump(mode="json"), sort_keys=False, allow_unicode=True, width=100).encode()


class PolicyBudget(Authored):
    """What permitted goals may cost.

    Attributes:
        goals_a_day: Approvals by this policy within 24 hours.
        sessions: Most that the `budget` of a goal graph may name; one that names none is not permitted.
        sim_time_s: The same for the simulated time of all executions of a goal [s].
    """

    goals_a_day: int = pydantic.Field(ge=1)
    sessions: int = pydantic.Field(ge=1)
    sim_time_s: float = pydantic.Field(gt=0)


class ApprovalPolicy(Authored):
    """What may run without a person, in any scene when none is named; a span of time may cross midnight."""

    approve: Literal[1] = 1
    skills: tuple[str, ...] = pydantic.Field(min_length=1)
    targets: tuple[str, ...] = pydantic.Field(min_length=1)
    scenes: tuple[str, ...] = ()
    from_utc: str = pydantic.Field(default="00:00", pattern=_TIME)
    until_utc: str = pydantic.Field(default="23:59", pattern=_TIME)
    budget: PolicyBudget


def iter_objections(policy: ApprovalPolicy, graph: GoalGraph, *, at: str, approved: int) -> Iterator[Problem]:
    """Why a goal graph is not permitted, at a wall time of `Clock.wall_iso`; none when it is.

    `approved` is the number of goals that this policy approved within the 24 hours before.
    """
    now, begin, end, budget = at[11:16], policy.from_utc, policy.until_utc, graph.spec.budget
    is_time = begin <= now <= end if begin <= end else now >= begin or now <= end
    most_of = policy.budget
    asked: list[tuple[str, object, bool, str]] = [
        ("scene", graph.spec.scene, graph.spec.scene in (policy.scenes or (graph.spec.scene,)), f"{policy.scenes}"),
        ("time", f"{now} UTC", is_time, f"{begin} to {end} UTC"),
        ("goals", f"{approved} within a day", approved < most_of.goals_a_day, f"at most {most_of.goals_a_day}"),
    ]
    for node, choice in graph.choices.items():
        asked.append((f"{node}.skill", choice.skill, choice.skill in policy.skills, format_names(policy.skills)))
        asked.append((f"{node}.target", choice.target, choice.target in policy.targets, format_names(policy.targets)))
    for name in ("sessions", "sim_time_s"):
        wanted, most = getattr(budget, name), getattr(most_of, name)
        asked.append((f"budget.{name}", wanted, wanted is not None and wanted <= most, f"at most {most}"))
    return (
        Problem("NOT_PERMITTED", f"{graph.name}: {where}", str(found), expected)
        for where, found, is_permitted, expected in asked
        if not is_permitted
    )


def restrict(policy: ApprovalPolicy, catalogue: Catalogue) -> Catalogue:
    """What the policy permits of a catalogue."""
    return replace(
        catalogue,
        skills={name: each for name, each in catalogue.skills.items() if name in policy.skills},
        targets={name: each for name, each in catalogue.targets.items() if name in policy.targets},
    )
