"""A run of a suite: its folder, what is left of it, and the loop that carries it out and can be killed at any time.

runs/<suite>-1/
  run.json          the compiled suite: every episode, what is missing and why, hashes of the files it names
  suite.yaml        as it was written
  episodes.jsonl    the records, one line an episode
  episodes/<id>-<attempt>/   workspace, memory and log of each
"""

import contextlib
import hashlib
import itertools
import os
import signal
import subprocess
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from phyagentos.assembly.process_tuning import end_with
from phyagentos.bench.availability import can_connect
from phyagentos.bench.engines import Engine
from phyagentos.bench.episode import Job
from phyagentos.bench.matrix import Plan
from phyagentos.bench.records import EpisodeLog, EpisodeRecord, Order
from phyagentos.bench.suite_file import MemoryUse, Policy
from phyagentos.clock import Clock
from phyagentos.errors import DefinitionError, ExecutionError, Problem
from phyagentos.protocol.documents.durable_files import replace_durably, require_empty
from phyagentos.protocol.documents.regular_files import read_regular
from phyagentos.protocol.sessions.evidence_manifest import PART_MAX
from phyagentos.protocol.workspace.process_lock import become_sole

MANIFEST, SUITE, LOCK = "run.json", "suite.yaml", ".lock"
READY_S = 120.0  # a policy server answers within this


class Manifest(msgspec.Struct, frozen=True, kw_only=True):
    """What a run is.

    Attributes:
        source: The suite's file; what it said stands in the folder of the run.
        project: Working folder, in which names were looked up.
        missing: Id of an episode -> why it cannot run here.
        files: Path -> SHA-256 of the suite, its goal graphs and its faults.
    """

    source: str
    project: str
    at: str
    orders: tuple[Order, ...]
    missing: dict[str, tuple[Problem, ...]]
    files: dict[str, str]
    seeds_max: int | None = None


def begin_run(folder: Path, source: Path, plan: Plan, clock: Clock, *, is_own: bool = False) -> Manifest:
    """Make the folder of a run; raises DefinitionError `WOULD_OVERWRITE`. A suite of its `own` is found there alone."""
    require_empty(folder, f"Continue it: paos bench resume {folder}. Or name another folder.")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SUITE).write_bytes(source.read_bytes())
    manifest = _describe(folder / SUITE if is_own else source, plan, clock.wall_iso(), Path.cwd())
    replace_durably(folder / MANIFEST, msgspec.json.format(msgspec.json.encode(manifest)))
    return manifest


def read_manifest(folder: Path) -> Manifest:
    """What a run is; raises DefinitionError `NOT_A_WORKSPACE`."""
    try:
        return msgspec.json.decode(read_regular(folder / MANIFEST, PART_MAX), type=Manifest)
    except (OSError, msgspec.MsgspecError) as error:
        hint = "Name a folder that `paos bench run` has made."
        found = "no such file" if isinstance(error, FileNotFoundError) else str(error)
        raise DefinitionError.of(
            "NOT_A_WORKSPACE", str(folder / MANIFEST), found, "the folder of a run", hint
        ) from error


def continue_run(folder: Path, plan: Plan) -> Manifest:
    """The manifest of a run that goes on, with what is missing today.

    Raises DefinitionError `CHANGED` where the suite, a goal graph or a file of faults is not what it was.
    """
    known = read_manifest(folder)
    today = _describe(Path(known.source), plan, known.at, Path(known.project))
    changed = [path for path in known.files | today.files if known.files.get(path) != today.files.get(path)]
    if msgspec.json.encode(known.orders) != msgspec.json.encode(today.orders):
        changed = changed or [known.source]
    if changed:
        hint = "Begin a new run; what this one has measured stays."
        found = "another content than when the run began"
        raise DefinitionError([Problem("CHANGED", path, found, "the same", hint) for path in changed])
    replace_durably(folder / MANIFEST, msgspec.json.format(msgspec.json.encode(today)))
    return today


def run_sweep(
    folder: Path, manifest: Manifest, engine: Engine, policies: Mapping[str, Policy], clock: Clock
) -> Iterator[EpisodeRecord]:
    """Carry out what has no record yet, pass after pass; yields each record once it is on the disk.

    Raises ExecutionError `BUSY` where another process works on the run.
    """
    lock = become_sole(folder / LOCK, clock, "BUSY", "another process works on this run")
    log = EpisodeLog(folder)
    left = [order for order in manifest.orders if order.id not in log.records and order.id not in manifest.missing]
    served = [policies[name] for name in dict.fromkeys(order.policy for order in left) if name]
    try:
        with engine.around, contextlib.closing(engine), _serving(served, Path(manifest.project), clock):
            for phase in dict.fromkeys(order.phase for order in left):
                chains: dict[str, deque[Order]] = {}
                for order in left:
                    if order.phase == phase:
                        chains.setdefault(order.chain or order.id, deque()).append(order)
                yield from _run_chains(deque(chains.values()), folder, manifest, engine, log)
    finally:
        log.close()
        os.close(lock)


def _run_chains(
    chains: deque[deque[Order]], folder: Path, manifest: Manifest, engine: Engine, log: EpisodeLog
) -> Iterator[EpisodeRecord]:
    """Every chain from its first order to its last, as many side by side as the engine takes."""
    running: dict[str, deque[Order]] = {}
    while (chains or running) and not engine.ends.is_set():
        while chains and len(running) < engine.jobs:
            chain = chains.popleft()
            order = chain.popleft()
            memory = _find_memory(order, manifest.orders, log.records)
            engine.submit(Job(order=order, run=str(folder.resolve()), memory=memory, project=manifest.project))
            running[order.id] = chain
        for record in engine.wait():
            if rest := running.pop(record.id):
                chains.appendleft(rest)
            if log.append(record):
                yield record


def _find_memory(order: Order, orders: Sequence[Order], done: Mapping[str, EpisodeRecord]) -> str:
    """Folder of the last adapting episode before this one, of the same policy, setting and mode; empty for none."""
    if order.memory not in {MemoryUse.FROZEN, MemoryUse.ADAPTING}:
        return ""
    found = ""
    for other in itertools.takewhile(lambda each: each.id != order.id, orders):
        record = done.get(other.id)
        if other.memory == MemoryUse.ADAPTING and other.lineage == order.lineage and record and record.ended == "over":
            found = record.folder
    return found


@contextlib.contextmanager
def _serving(policies: Sequence[Policy], project: Path, clock: Clock) -> Iterator[None]:
    """The servers of policies while the block runs; raises `POLICY_UNREACHABLE` where one does not answer in time."""
    end_with_us = partial(end_with, os.getpid())
    served = [policy for policy in policies if policy.serve]
    quiet: Any = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "start_new_session": True}
    servers = [
        subprocess.Popen(policy.command, cwd=project, preexec_fn=end_with_us, **quiet)  # noqa: PLW1509 - no thread yet
        for policy in served
    ]
    try:
        until_s = clock.now_s() + READY_S
        for policy, server in zip(served, servers, strict=True):
            while policy.ready and not can_connect(policy.ready):
                if clock.now_s() > until_s or server.poll() is not None:
                    found = f"{' '.join(policy.command)} does not listen at {policy.ready}"
                    raise ExecutionError("POLICY_UNREACHABLE", found)
                clock.sleep(0.1)
        yield
    finally:
        for server in servers:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(server.pid, signal.SIGTERM)
            server.wait()


def _describe(source: Path, plan: Plan, at: str, project: Path) -> Manifest:
    named = {order.graph for order in plan.orders} | {str(order.variant.get("faults")) for order in plan.orders}
    paths = [path for path in (str(source.resolve()), *sorted(named)) if Path(path).is_file()]
    return Manifest(
        source=str(source.resolve()),
        project=str(project),
        at=at,
        orders=plan.orders,
        missing=dict(plan.missing),
        seeds_max=plan.seeds_max,
        files={path: hashlib.sha256(Path(path).read_bytes()).hexdigest() for path in paths},
    )
