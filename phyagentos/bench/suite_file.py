"""A suite as a person writes it: tasks x initial states x seeds x policies x settings x verification modes, in passes.

Each value of an axis is a `Variant`: how its episodes differ from an ordinary `paos run`. `matrix` compiles a suite
into episodes, `availability` says which of them cannot run here.
"""

from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import pydantic

from phyagentos.protocol.capabilities.environments import EnvironmentSpec, find_python
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Authored, Located, read_yaml, validate
from phyagentos.protocol.settings.perception import Prior, Sensing
from phyagentos.protocol.settings.runtime_contract import WorldMode
from phyagentos.protocol.settings.verification_mode import VerificationMode

NAME = r"^[a-z0-9][a-z0-9_]*$"
FOLDER, ENVIRONMENTS = "benchmarks/suites", "benchmarks/environments"
Name = Annotated[str, pydantic.Field(pattern=NAME, max_length=60)]


class MemoryUse(StrEnum):
    """What episodes do with experience."""

    NONE = "none"
    """Each is an independent trial: nothing is remembered."""
    FROZEN = "frozen"
    """What earlier passes have learned advises; nothing is added to it."""
    ADAPTING = "adapting"
    """Each episode learns, and begins with what the one before has left."""
    EMPTIED = "emptied"
    """As frozen, with an empty memory: what is left is not due to experience."""


class Variant(Authored):
    """How episodes differ from an ordinary `paos run`; of two that say the same key, the later axis is heard.

    Attributes:
        set: As `--set`: a parameter of the goal graph, `targets.ROLE`, or a dotted path of it -> value.
        files: Settings file -> dotted path -> value, in the workspace of the episode.
        faults: What shall go wrong: a file of faults beside the suite, or the name of one.
        world_mode: As `--world-mode`.
        sense: As `--sense`.
        prior: As `--prior`.
        pictures: Whether pictures for people are rendered.
        repair: What follows a missed objective: `repair`, or what an installed package announces.
        memory: What its episodes do with experience: `none` where no axis says it.
        environment: One of the suite's `environments` that must stand, or the episodes are missing.
        needs: Modules of this Python that must be there, or the episodes are missing.
    """

    set: Fields = {}
    files: dict[str, Fields] = {}
    faults: str | None = None
    world_mode: WorldMode | None = None
    sense: Sensing | None = None
    prior: Prior | None = None
    pictures: bool | None = None
    repair: str | None = None
    memory: MemoryUse | None = None
    environment: str | None = None
    needs: tuple[str, ...] = ()


class Policy(Variant):
    """A policy, and the server that is started for it.

    Attributes:
        serve: Command of its server, which runs while the episodes do; none where another one serves it, or none does.
            Where it begins with `python`, that is the Python of the policy's `environment`, if it has one.
        ready: Host and port that are connected to before the first episode.
    """

    serve: tuple[str, ...] = ()
    ready: str = pydantic.Field(default="", pattern=r"^$|^[^\s:]+:\d+$")

    @property
    def command(self) -> tuple[str, ...]:
        """What is started."""
        if self.environment is None or self.serve[:1] != ("python",):
            return self.serve
        return (str(find_python(self.environment).absolute()), *self.serve[1:])


class Seeds(Authored):
    """Seeds in a row.

    Attributes:
        first: The first one.
        count: How many.
    """

    first: int = pydantic.Field(default=0, ge=0)
    count: int = pydantic.Field(ge=1)


SeedList = Seeds | tuple[Annotated[int, pydantic.Field(ge=0)], ...]


class Task(Variant):
    """One goal graph.

    Attributes:
        graph: Path beside the suite, else name of a goal graph; or `module:function`, which draws one from a seed:
            it gets the seed and an empty folder, writes a project there, and returns the path of its goal graph.
        initial_states: Its own, instead of those of the suite.
        score: Part of the goal -> what the suite's scorer asks of it. A part named like a node is asked for after the
            node's sessions, too.
        scored: When the parts count: at the `end`, or each after the last session of its `node`.
        scorer: Its own, instead of that of the suite.
    """

    graph: str
    initial_states: dict[Name, Variant] = {}
    score: Fields = pydantic.Field(min_length=1)
    scored: Literal["end", "node"] = "end"
    scorer: str | None = None


class Pass(Variant):
    """One pass over the suite; passes follow each other, and what a setting says is heard after them.

    Attributes:
        seeds: Its own, instead of those of the suite.
        tasks: These alone, where it names any.
    """

    seeds: SeedList | None = None
    tasks: tuple[str, ...] = ()


class Figure(StrEnum):
    """A figure that a suite can ask for."""

    FINAL = "final"
    """Share of episodes whose goal is met, as the scorer says."""
    VERIFIED = "verified"
    """Share of episodes whose goal is met, as the scorer and the verdict say."""
    FIRST = "first"
    """Share of episodes whose goal is met without any repair, as the scorer says."""
    PARTS = "parts"
    """Share of parts that are there in the end."""
    FIRST_PARTS = "first_parts"
    """Share of parts that are there after the first session of their node."""
    REPEATS = "repeats"
    """Share of the chances to fail as an earlier episode of the task did (node and cause) that were taken."""
    FALSE_SUCCESSES = "false_successes"
    """Episodes with a verdict `success`, on the goal or on a session, that the scorer denies."""
    FALSE_FAILURES = "false_failures"
    """Episodes with another verdict whose goal is met, as the scorer says."""
    SESSIONS = "sessions"
    """Mean number of sessions of an episode."""
    CONTACTS = "contacts"
    """Contacts of robots with each other."""
    STAGE_MS = "stage_ms"
    """Median wall time of a session's stage, `part` (`planning`, `lookahead`, ...) [ms]."""
    OTHER_BITS = "other_bits"
    """Episodes whose recorded states and trajectories differ from those of their pair in `than`."""
    MEMORY_CHANGED = "memory_changed"
    """Episodes of frozen passes after which memory holds something else."""
    P_VALUE = "p_value"
    """Of the pairs with `than`: how likely such a difference is by chance, two-sided; McNemar's exact test, and of
    `sessions` Wilcoxon's signed-rank test."""


SHARES = {Figure.FINAL, Figure.VERIFIED, Figure.FIRST, Figure.PARTS, Figure.FIRST_PARTS, Figure.P_VALUE}


class FigureThreshold(Authored):
    """A figure that the suite promises.

    Attributes:
        figure: Which.
        where: Axis (`task`, `state`, `policy`, `setting`, `verification`, `pass`) -> value: of these episodes only.
        part: Of this part, or stage, only.
        than: The same of other episodes, which is subtracted; `p_value` is of the pairs with them.
        of: What the pairs of `p_value` compare: `final`, `first`, `parts`, `first_parts` or `sessions`.
        at_least: The least value.
        at_most: The greatest one.
    """

    figure: Figure
    where: dict[str, str] = {}
    part: str = ""
    than: dict[str, str] | None = None
    of: Figure = Figure.FINAL
    at_least: float | None = None
    at_most: float | None = None


class Suite(Authored):
    """A suite; the product of its axes is its episodes.

    Attributes:
        version: Of this format.
        suite: Its name.
        objective: What it measures, in words.
        environments: Python environments of other systems, which `paos bench setup NAME` makes.
        common: Of every episode.
        tasks: By name, which begins the ids of their goals.
        initial_states: How the world begins, by name; as the scene says where there is none.
        seeds: Roots of all chance.
        policies: By name.
        settings: By name.
        verification: Modes of verification; that of runtime_contract.yaml where there is none.
        passes: By name, in order.
        scorer: Says independently of verdicts what was achieved.
        wall_s: An episode that takes longer hangs, and is ended [s].
        asked: Figures that must hold.
    """

    version: Literal[1] = 1
    suite: Name
    objective: str
    environments: dict[Name, EnvironmentSpec] = {}
    common: Variant = Variant()
    tasks: dict[Name, Task] = pydantic.Field(min_length=1)
    initial_states: dict[Name, Variant] = {}
    seeds: SeedList
    policies: dict[Name, Policy] = {}
    settings: dict[Name, Variant] = {}
    verification: tuple[VerificationMode, ...] = ()
    passes: dict[Name, Pass] = {}
    scorer: str = "simulator"
    wall_s: float = pydantic.Field(default=900.0, gt=0.0)
    asked: tuple[FigureThreshold, ...] = ()


def list_seeds(seeds: SeedList) -> tuple[int, ...]:
    """The seeds one by one, each once."""
    return tuple(range(seeds.first, seeds.first + seeds.count) if isinstance(seeds, Seeds) else dict.fromkeys(seeds))


def merge(variants: Iterable[Variant]) -> Variant:
    """What several axes say together: mappings are joined, and of two values of a key the later one is heard."""
    merged: Fields = {"set": {}, "files": {}, "needs": ()}
    for variant in variants:
        said = {key: getattr(variant, key) for key in Variant.model_fields if getattr(variant, key) is not None}
        files = merged["files"] | {name: merged["files"].get(name, {}) | each for name, each in variant.files.items()}
        joined = {"set": merged["set"] | variant.set, "files": files, "needs": (*merged["needs"], *variant.needs)}
        merged |= said | joined
    return Variant(**merged)


def read_suite(path: Path) -> tuple[Suite, Located]:
    """Read a suite; raises DefinitionError with every problem of its form at file:line:column."""
    located = read_yaml(path)
    return validate(Suite, located), located
