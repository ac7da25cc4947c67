"""CALVIN's sequences of five instructions in its scene D, by the builtin skills, beside the benchmark's own oracles.

    git clone --recurse-submodules https://github.com/mees/calvin FOLDER
    paos bench setup calvin --from FOLDER               # a Python environment: 1.2 GB
    python -m benchmarks.calvin --results calvin.jsonl --count 100
    python -m benchmarks.calvin --show --results calvin.jsonl     # the figures of what has been run

The sequences are the official ones (1000 are drawn, the first `--count` are run), and so are initial states,
instructions and oracles. Nothing is reset between the instructions of a sequence, and one that fails ends it. Each is
one request in words, understood, planned by effects and run as a goal; no code and no setting is of a task.

State is given: the simulator's poses, shapes, joints. Published policies see pixels alone. An oracle counts here where
it is met after some step of the instruction's sessions, as in published evaluations; those end an instruction after
360 steps (12 s), which nothing ends here: its simulated time is printed instead.

Final: oracle and verdict both say so. First: the same without a second session of any node. False success: a verdict
`success` where the oracle was never met. Each instruction is one line of the results file; the last line is JSON.
"""

import argparse
import json
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console
from rich.table import Table

from benchmarks.calvin_parts.project import (
    ROBOT,
    read_profile,
    read_world,
    translate,
    write_project,
)
from benchmarks.libero_parts.served import ROOT, Server, serve_module
from benchmarks.libero_parts.tasks import open_workspace
from benchmarks.runner import finish
from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.mission.report import MissionReport
from phyagentos.assembly.agent_plane import Agent
from phyagentos.bench.report import Threshold
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.evidence import AFTER
from phyagentos.protocol.settings.perception import Sensing
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment

LENGTH = 5
KIT = ROOT / "kits" / "calvin"
ASKED = {
    "average_final": Threshold(4.0, at_least=True),
    "false_successes": Threshold(0.0, at_least=False),
    "missing": Threshold(0.0, at_least=False),
}
PUBLISHED = "published, policies that see pixels alone: average 3.13 to 4.69 First, 3.25 to 4.75 Final"
Record = dict[str, Any]


def main() -> int:
    """Run what is missing, show everything, and exit with whether every asked figure holds."""
    given = parse_arguments()
    known = read_results(given.results)
    chosen = given.sequences or list(range(given.count))
    if missing := [each for each in chosen if not is_ended(known.get(each, ()))]:
        for record in () if given.show else run(given, missing):
            with given.results.open("a") as file:
                file.write(json.dumps(record) + "\n")
            Console(stderr=True).print(describe(record), highlight=False, markup=False)
        known = read_results(given.results)
    ended = [known[each] for each in chosen if is_ended(known.get(each, ()))]
    figures = compute_figures(ended) | {"missing": float(len(chosen) - len(ended))}
    show(Console(), ended, figures)
    return finish(figures, ASKED)


def parse_arguments() -> argparse.Namespace:
    """What is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", type=Path, default=Path("build/calvin/bin/python"))
    parser.add_argument("--count", type=int, default=100, help="of the official sequences, the first ones")
    parser.add_argument("--sequences", type=int, nargs="*", help="these instead, by number")
    parser.add_argument("--show", action="store_true", help="run nothing, show the figures of the results")
    parser.add_argument("--results", type=Path, required=True, help="one JSON line an instruction; it is appended to")
    parser.add_argument("--keep", type=Path, help="folder for project and workspace, kept afterwards")
    return parser.parse_args()


def read_results(path: Path) -> dict[int, list[Record]]:
    """Instructions by sequence, of its latest run; a line that a kill cut off is left out."""
    known: dict[int, list[Record]] = {}
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            record = json.loads(line)
            before = known.get(record["sequence"], []) if record["number"] else []
            known[record["sequence"]] = [*before, record]
        except (ValueError, KeyError):
            continue
    return known


def is_final(record: Mapping[str, Any]) -> bool:
    """Whether oracle and verdict both say that the instruction is met."""
    return bool(record["reached"]) and record["verdict"] == "success"


def is_ended(records: Sequence[Mapping[str, Any]]) -> bool:
    """Whether a sequence was run to its end, or to its first failure."""
    return bool(records) and (len(records) == LENGTH or not is_final(records[-1]))


def run(given: argparse.Namespace, sequences: Sequence[int]) -> Iterator[Record]:
    """Every instruction of sequences, each as it ended."""
    folder = given.keep or given.results.with_suffix(".work")
    folder.mkdir(parents=True, exist_ok=True)
    profile, outcomes = read_profile(), folder / "outcomes.jsonl"
    try:
        with serve_module("calvin_body", given.python.absolute(), profile, {}, outcomes, KIT) as server:
            told = server.describe(profile, sequences=list(sequences))
            write_project(folder / "project", told, server.endpoint)
            number = sum(1 for _ in folder.glob("w*"))
            workspace = open_workspace(folder / f"w{number}", folder / "project", server, ROBOT)
            with open_bench(workspace, SystemClock(), sense=Sensing.TRUTH) as agent:
                for sequence in sequences:
                    yield from run_sequence(sequence, told["sequences"][str(sequence)], agent, workspace, server)
    finally:
        if given.keep is None:
            shutil.rmtree(folder, ignore_errors=True)


def run_sequence(
    sequence: int, told: Mapping[str, Any], agent: Agent, workspace: Workspace, server: Server
) -> Iterator[Record]:
    """Its instructions one after the other, until one fails."""
    catalogue, world = Catalogue.of_workspace(workspace), read_world(told["entities"])
    for number, instruction in enumerate(told["instructions"]):
        record: Record = {"sequence": sequence, "number": number, "instruction": instruction, "reached": False}
        text, reason = translate(instruction, catalogue, world)
        if not text:
            yield record | {"verdict": "untranslated", "reason": reason}
            return
        graph = workspace.root.parent / f"s{sequence}_{number}.yaml"
        graph.write_text(text)
        report = agent.mission.run(graph, seed=LENGTH * sequence + number)
        record |= score(report, server)
        yield record
        if not is_final(record):
            return
        world = read_now(workspace, report)


def read_now(workspace: Workspace, report: MissionReport) -> Environment:
    """What was observed at the end of the latest session that began."""
    files = (workspace.evidence_of(each.id) / AFTER for each in reversed(report.sessions))
    return msgspec.json.decode(next(path for path in files if path.exists()).read_bytes(), type=Environment)


def score(report: MissionReport, server: Server) -> Record:
    """The verdict beside what the oracle said during its sessions."""
    lines = server.read_outcomes()
    scored = [lines[each.id] for each in report.sessions if each.id in lines]
    return {
        "verdict": report.verdict,
        "reason": report.reason,
        "reached": any(each["reached"] for each in scored),
        "success": bool(scored and scored[-1]["success"]),
        "task": scored[-1]["task"] if scored else "",
        "is_first": report.replans == 0 and all(report.first_attempt_success.values()),
        "sim_s": round(sum(each.sim_time_s for each in report.sessions), 2),
        "ended": [
            f"{each.node}: {each.verdict or each.state} {each.cause} {each.code} {each.leaf}"
            for each in report.sessions
        ],
    }


def describe(record: Mapping[str, Any]) -> str:
    """One line of an instruction."""
    said = f"{record['verdict']}, oracle {record['reached']}"
    return f"{record['sequence']}.{record['number']} {record['instruction']!r}: {said} {record.get('reason', '')}"


def compute_figures(sequences: Sequence[Sequence[Mapping[str, Any]]]) -> dict[str, float]:
    """Shares of sequences whose first instructions are met, averages of how many are, and false successes."""
    finals = [sum(map(is_final, records)) for records in sequences]
    firsts = [_count_first(records) for records in sequences]
    count = len(sequences)
    figures = {"sequences": float(count)}
    for name, lengths in (("first", firsts), ("final", finals)):
        figures |= {f"{name}_{n}": sum(each >= n for each in lengths) / max(count, 1) for n in range(1, LENGTH + 1)}
        figures[f"average_{name}"] = sum(lengths) / max(count, 1)
    each = [record for records in sequences for record in records]
    figures["false_successes"] = float(sum(r["verdict"] == "success" and not r["reached"] for r in each))
    figures["untranslated"] = float(sum(r["verdict"] == "untranslated" for r in each))
    return figures


def _count_first(records: Sequence[Mapping[str, Any]]) -> int:
    """Instructions met one after the other, each without a second session of any node."""
    met = [is_final(each) and bool(each["is_first"]) for each in records]
    return met.index(False) if False in met else len(met)


def show(console: Console, sequences: Sequence[Sequence[Mapping[str, Any]]], figures: Mapping[str, float]) -> None:
    """Success after 1 to 5 instructions, and a row an instruction."""
    chain = Table("", *map(str, range(1, LENGTH + 1)), "average", title=f"CALVIN, {len(sequences)} sequences, state")
    for name in ("first", "final"):
        shares = (f"{figures[f'{name}_{n}']:.0%}" for n in range(1, LENGTH + 1))
        chain.add_row(name.title(), *shares, f"{figures[f'average_{name}']:.2f}")
    console.print(chain, PUBLISHED)
    each = [record for records in sequences for record in records]
    table = Table("instruction", "Final", "First", "false success", "sim, s")
    for text in sorted({record["instruction"] for record in each}):
        own = [record for record in each if record["instruction"] == text]
        first = sum(is_final(r) and r["is_first"] for r in own)
        false = sum(r["verdict"] == "success" and not r["reached"] for r in own)
        spent_s = sum(r.get("sim_s", 0.0) for r in own) / len(own)
        table.add_row(text, f"{sum(map(is_final, own))}/{len(own)}", str(first), str(false), f"{spent_s:.0f}")
    console.print(table)


if __name__ == "__main__":
    sys.exit(main())
