"""A suite compiled into episodes: the product of its axes, each cell checked and looked for on this machine once."""

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from phyagentos.bench.availability import Gate
from phyagentos.bench.records import Order
from phyagentos.bench.suite_checks import SuiteChecks
from phyagentos.bench.suite_file import (
    ENVIRONMENTS,
    FOLDER,
    MemoryUse,
    Pass,
    Policy,
    Suite,
    Task,
    Variant,
    list_seeds,
    read_suite,
)
from phyagentos.errors import DefinitionError, Problem, raise_any
from phyagentos.protocol.capabilities.environments import EnvironmentSpec
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.documents.schema import Address, read_yaml, validate


@dataclass(frozen=True, slots=True)
class Plan:
    """A compiled suite: every episode, in the order of its axes, and by id why some cannot run here."""

    suite: Suite
    orders: tuple[Order, ...]
    missing: Mapping[str, tuple[Problem, ...]]
    seeds_max: int | None = None


@dataclass(frozen=True, slots=True)
class Cell:
    """A point of the matrix without its mode and its seed: its place on each axis, and its variants by their place."""

    axes: Mapping[str, str]
    task: Task
    policy: Policy
    passed: Pass
    layers: Mapping[Address, Variant]


def list_suites() -> dict[str, Path]:
    """Suites in `benchmarks/suites/` of the libraries, by name."""
    return {path.stem: path for path in _list_files(FOLDER)}


def _list_files(folder: str) -> list[Path]:
    """Files in a folder of the libraries; of several with a name the last one counts."""
    roots = reversed(Library.open(Path.cwd()).roots)
    return [path for root in roots for path in sorted((root / folder).glob("*.yaml"))]


def find_suite(name: Path) -> Path:
    """The file of a suite: a path, or a name; raises `UNKNOWN_NAME`."""
    known = {} if name.is_file() else list_suites()
    if not name.is_file() and name.stem not in known:
        raise DefinitionError.unknown("file", str(name), name.stem, known)
    return known.get(name.stem, name)


def find_environments(name: str) -> dict[str, EnvironmentSpec]:
    """Environments of a suite, by the suite's file or name, or one by its own name; raises `UNKNOWN_NAME`."""
    if Path(name).is_file() or name in (known := list_suites()):
        return read_suite(find_suite(Path(name)))[0].environments
    declared = {key: spec for path in known.values() for key, spec in read_suite(path)[0].environments.items()}
    declared |= {path.stem: validate(EnvironmentSpec, read_yaml(path)) for path in _list_files(ENVIRONMENTS)}
    if name not in declared:
        raise DefinitionError.unknown("environment", "paos bench setup", name, {*declared, *known})
    return {name: declared[name]}


def compile_suite(path: Path, seeds_max: int | None = None, *, runs_python: bool = False) -> Plan:
    """Every episode of a suite, or of so many seeds of each pass, and which of them cannot run here.

    Predicates of its goal graphs' projects are executed only where it `runs_python`.

    Raises DefinitionError with every problem of the suite, and of the goal graphs, settings and faults that it names.
    """
    suite, located = read_suite(path)
    checks, gate = SuiteChecks(suite, located, runs_python=runs_python), Gate(suite.environments)
    orders: list[Order] = []
    missing: dict[str, tuple[Problem, ...]] = {}
    for cell in iter_cells(suite):
        seeds = list_seeds(cell.passed.seeds or suite.seeds)[:seeds_max]
        graph, variant = checks.resolve(cell.task, cell.axes["task"], cell.layers)
        lacks = gate.find_lacks(variant, cell.policy, checks.check_graph(graph, variant, cell.layers, seeds[0]))
        for mode, seed in itertools.product(suite.verification or ("",), seeds):
            orders.append(order := make_order(suite, cell, graph, variant, str(mode), seed))
            if lacks:
                missing[order.id] = lacks
    checks.check_asked(orders)
    raise_any(checks.problems)
    return Plan(suite, tuple(orders), missing, seeds_max)


def iter_cells(suite: Suite) -> Iterator[Cell]:
    """Passes x tasks x initial states x policies x settings."""
    policies, settings = suite.policies or {"": Policy()}, suite.settings or {"": Variant()}
    passes = suite.passes or {"": Pass()}
    for (phase, passed), (name, task) in itertools.product(passes.items(), suite.tasks.items()):
        if passed.tasks and name not in passed.tasks:
            continue
        owner: Address = ("tasks", name) if task.initial_states else ()
        states = task.initial_states or suite.initial_states or {"": Variant()}
        for state, policy, setting in itertools.product(states, policies, settings):
            axes = {"phase": phase, "task": name, "state": state, "policy": policy, "setting": setting}
            layers: dict[Address, Variant] = {
                ("common",): suite.common,
                ("tasks", name): task,
                (*owner, "initial_states", state): states[state],
                ("policies", policy): policies[policy],
                ("passes", phase): passed,
                ("settings", setting): settings[setting],
            }
            yield Cell(axes, task, policies[policy], passed, layers)


def make_order(suite: Suite, cell: Cell, graph: str, variant: Variant, mode: str, seed: int) -> Order:
    """The episode of a cell with a mode and a seed."""
    axes, memory = cell.axes, variant.memory or MemoryUse.NONE
    lineage = "/".join((axes["policy"], axes["setting"], mode))  # episodes that share experience
    return Order(
        id=".".join([*filter(None, (*axes.values(), mode)), str(seed)]),
        **axes,
        verification=mode,
        seed=seed,
        graph=graph,
        goal=f"{axes['task']}-{seed}",
        variant=variant.model_dump(mode="json", exclude_defaults=True),
        memory=memory,
        lineage=lineage,
        chain=f"{axes['phase']}/{lineage}" if memory is MemoryUse.ADAPTING else "",
        scorer=cell.task.scorer or suite.scorer,
        score=cell.task.score,
        scored=cell.task.scored,
        wall_s=suite.wall_s,
    )
