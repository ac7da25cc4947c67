"""Where each lesson of a run may be used: `python -m benchmarks.transfer RUN`, of a run of `constant` or `game_to_arm`.

Each lesson in force, of the memory that has most records, is held against the first attempts on record there, target by
target: how many it may advise, and what is in the way otherwise; then the same as if skill and scene were the same, so
that the body alone decides.
"""

import argparse
import json
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from msgspec.structs import replace

from benchmarks.runner import show
from phyagentos.agent.memory.episodes import Episode
from phyagentos.agent.memory.memory import Memory
from phyagentos.agent.memory.methodological import Correction
from phyagentos.agent.memory.scopes import compute_scope, find_mismatch
from phyagentos.bench.records import read_records
from phyagentos.bench.suite_file import MemoryUse
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.memory_entries import Scope

Line = tuple[str, str, str, int, int, int, str]


def open_memory(run: Path, copy: Path) -> Memory:
    """A copy of the memory that the last adapting episode of a run has left."""
    *_, last = (each for each in read_records(run) if each.memory == MemoryUse.ADAPTING and each.memory_after)
    return Memory(shutil.copytree(run / last.folder / "memory", copy), clock=SystemClock(), by="bench")


def compare(memory: Memory) -> Iterator[Line]:
    """A line for each lesson in force and each target on record."""
    first = [each for each in memory.read_all() if isinstance(each, Episode) and each.is_first and not each.purpose]
    lessons = [each for each in memory.experience.corrections.values() if each.is_active(memory.experience.seq)]
    for lesson in lessons:
        for target in dict.fromkeys(each.target for each in first):
            cases = [compute_scope(each) for each in first if each.target == target]
            reasons = [_find_mismatch(lesson, lesson.where, case) for case in cases]
            alike = [_find_mismatch(lesson, replace(lesson.where, skill="", scene=""), case) for case in cases]
            why = Counter(filter(None, reasons)).most_common(1)
            held = (len(cases), reasons.count(""), alike.count(""))
            yield lesson.id, lesson.where.target, target, *held, why[0][0] if why else ""


def _find_mismatch(lesson: Correction, where: Scope, case: Scope) -> str:
    return find_mismatch(where, case, lesson.tried_way)


def sum_up(lines: list[Line]) -> dict[str, int]:
    """Pairs of a lesson and a first attempt, by whether both are of the same target."""
    own, other = ([line for line in lines if (line[1] == line[2]) is same] for same in (True, False))
    return {
        "lessons": len({line[0] for line in lines}),
        **{f"{name}_{key}": sum(line[3 + index] for line in part) for name, part in (("own", own), ("other", other))
           for index, key in enumerate(("pairs", "usable", "usable_but_for_skill_and_scene"))},
    }  # fmt: skip


def main() -> None:
    """Print the table and its sums."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("run", type=Path)
    with tempfile.TemporaryDirectory() as folder:
        lines = [*compare(open_memory(parser.parse_args().run, Path(folder) / "memory"))]
    columns = ("lesson", "learned by", "target", "first attempts", "usable", "by body alone", "mostly because")
    show("Where lessons may be used", columns, lines)
    print(json.dumps({"figures": sum_up(lines)}))


if __name__ == "__main__":
    main()
