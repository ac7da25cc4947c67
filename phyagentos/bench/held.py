"""What is held constant over the targets of a run, by hashes, and what differs between them, in words.

Code counts by the source that ran: what compiles, plans and repairs; memory; the verifier. Settings are those of
runtime_contract.yaml that no profile of a target declares, and how it senses. Targets are their profiles with limits,
sensors and sensing; adapters the drivers that reach them.
"""

import hashlib
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path

import msgspec

from phyagentos.bench.records import EpisodeRecord, Held
from phyagentos.protocol.capabilities.registries import read_skill_registry, read_target_registry
from phyagentos.protocol.capabilities.targets import TargetProfile, find_driver_name
from phyagentos.protocol.settings.perception import read_perception
from phyagentos.protocol.settings.runtime_contract import read_runtime_contract
from phyagentos.protocol.workspace.workspace import Workspace

CODE = {
    "planner": ("agent/goals", "agent/mission", "agent/planning", "agent/repair"),
    "memory": ("agent/memory",),
    "verifier": ("agent/judging", "protocol/predicates"),
}
SENSING = {"sensing", "prior"}


class HeldRow(msgspec.Struct, frozen=True, kw_only=True):
    """One part of what decides an episode: task -> its hashes, and what it says there and not for every task."""

    part: str
    hashes: dict[str, tuple[str, ...]]
    own: dict[str, tuple[str, ...]]

    @property
    def is_constant(self) -> bool:
        """Whether it is the same in every episode."""
        return len({each for hashes in self.hashes.values() for each in hashes}) == 1


def read_held(workspace: Workspace, targets: Collection[str]) -> dict[str, Held]:
    """What decides an episode on these targets, but for its goal and seed."""
    profiles = [each for name, each in read_target_registry(workspace.target_registry).items() if name in targets]
    bodies = [path.read_bytes() for path in (workspace.safety, workspace.sensors, workspace.perception)]
    bodies += [each.model_dump_json().encode() for each in profiles]
    settings = tuple(_iter_settings(workspace))
    drivers = tuple(sorted({find_driver_name(each) for each in profiles}))
    return {
        **{part: Held(hash=_hash_code(folders)) for part, folders in CODE.items()},
        "settings": Held(hash=_hash(map(str.encode, settings)), says=settings),
        "targets": Held(hash=_hash(bodies), says=tuple(each.target for each in profiles)),
        "adapters": Held(hash=_hash(map(str.encode, drivers)), says=drivers),
        "skills": Held(
            hash=_hash([workspace.skill_registry.read_bytes()]),
            says=tuple(read_skill_registry(workspace.skill_registry)),
        ),
    }


def compare_held(records: Sequence[EpisodeRecord]) -> tuple[HeldRow, ...]:
    """Each part over the tasks of a run."""
    parts = dict.fromkeys(part for record in records for part in record.held)
    return tuple(_compare(part, [record for record in records if part in record.held]) for part in parts)


def _compare(part: str, records: Sequence[EpisodeRecord]) -> HeldRow:
    said: dict[str, dict[str, None]] = {}
    hashes: dict[str, dict[str, None]] = {}
    for record in records:
        held = record.held[part]
        said.setdefault(record.task, {}).update(dict.fromkeys(held.says))
        hashes.setdefault(record.task, {})[held.hash] = None
    common = set.intersection(*(set(each) for each in said.values()))
    own = {task: tuple(each for each in says if each not in common) for task, says in said.items()}
    return HeldRow(part=part, hashes={task: tuple(each) for task, each in hashes.items()}, own=own)


def _iter_settings(workspace: Workspace) -> Iterator[str]:
    """`path: value`, of what is no target's, defaults included."""
    contract = read_runtime_contract(workspace.runtime_contract).model_dump(
        mode="json", exclude={*TargetProfile.model_fields}
    )
    perception = read_perception(workspace.perception)
    return _iter_leaves("", contract | perception.model_dump(mode="json", include=SENSING))


def _iter_leaves(path: str, value: object) -> Iterator[str]:
    if isinstance(value, dict):
        for key in sorted(value):
            yield from _iter_leaves(f"{path}.{key}" if path else key, value[key])
    else:
        yield f"{path}: {value}"


@cache
def _hash_code(folders: Iterable[str]) -> str:
    root = Path(__file__).parents[1]
    files = (path for folder in folders for path in sorted((root / folder).rglob("*")))
    return _hash(path.read_bytes() for path in files if path.is_file() and path.suffix != ".pyc")


def _hash(contents: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for content in contents:
        digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()[:12]
