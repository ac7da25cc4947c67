"""What is wrong in a suite and in what it names, each at its place; nothing has run."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path

from msgspec.structs import replace

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import GoalGraph, read_goal_graph
from phyagentos.assembly.planted_faults import check_planted
from phyagentos.assembly.project import find_project
from phyagentos.bench.episode import change, make_overrides
from phyagentos.bench.plug_ins import draw, load_repair, load_scorer
from phyagentos.bench.records import BY_NAME, Order
from phyagentos.bench.suite_file import SHARES, Figure, Suite, Task, Variant, merge
from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Address, Located, read_yaml, validate
from phyagentos.protocol.predicates.project_predicates import load_predicates
from phyagentos.protocol.settings.settings_files import SETTINGS_FILES
from phyagentos.protocol.world.faults import read_faults
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.scratch import open_scratch


class SuiteChecks:
    """Problems of one suite, found cell by cell; what many cells share may stand there more than once.

    Predicates of the projects are executed only where it `runs_python`.
    """

    def __init__(self, suite: Suite, located: Located, *, runs_python: bool = False) -> None:
        self.problems: list[Problem] = []
        self._suite, self._located = suite, located
        self._graphs: dict[tuple[str, str, str | None], tuple[tuple[TargetProfile, Path], ...]] = {}
        self._read_catalogue = cache(partial(_read_catalogue, runs_python=runs_python))
        self._scored: dict[Address, tuple[str, ...]] = {}  # bodies by the place of the condition that names them
        for phase, passed in suite.passes.items():
            for unknown in (each for each in passed.tasks if each not in suite.tasks):
                self._miss("task", ("passes", phase, "tasks"), unknown, suite.tasks)
        for name, task in suite.tasks.items():
            with self._noting():
                of_task: Address = ("tasks", name, "scorer")
                named = located.address_of(of_task if task.scorer else ("scorer",))
                scorer = load_scorer(task.scorer or suite.scorer, named)
                for part, condition in task.score.items():
                    problems = scorer.check(located, place := ("tasks", name, "score", part), condition)
                    self.problems += problems
                    self._scored[place] = () if problems else scorer.list_bodies(condition)

    def resolve(self, task: Task, name: str, layers: Mapping[Address, Variant]) -> tuple[str, Variant]:
        """The goal graph of a cell, and what its layers say together, with paths for names."""
        for place, variant in layers.items():
            self._check_layer(place, variant)
        merged = merge(layers.values())
        if merged.faults is not None:
            place = [place for place, variant in layers.items() if variant.faults is not None][-1]
            path = self._find(merged.faults, (*place, "faults"), "faults")
            with self._noting():
                if Path(path).is_file():
                    read_faults(Path(path))
            merged = merged.model_copy(update={"faults": path})
        place = ("tasks", name, "graph")
        return task.graph if ":" in task.graph else self._find(task.graph, place, "goal_graphs"), merged

    def check_graph(
        self, graph: str, variant: Variant, layers: Mapping[Address, Variant], seed: int
    ) -> tuple[tuple[TargetProfile, Path], ...]:
        """Check a goal graph and the settings of a cell; the targets that it runs on, each with its profile's file.

        One that is drawn is checked as it is drawn from `seed`.
        """
        key = (graph, repr(sorted(variant.set.items())), variant.faults)
        with self._noting(), open_scratch() as scratch:
            path = draw(graph, seed, scratch) if ":" in graph else Path(graph)
            if not path.is_file():
                return ()
            catalogue, library = self._read_catalogue(path)
            self._check_files(library, layers)
            if key not in self._graphs:
                self._graphs[key] = ()
                compiled = self._compile(path, catalogue, variant, layers)
                names = dict.fromkeys(choice.target for choice in compiled.choices.values())
                self._graphs[key] = tuple((catalogue.targets[name], library.get_target(name)) for name in names)
                bodies = read_scene(library.get_scene(compiled.spec.scene)).bodies
                for place, names_scored in self._scored.items():
                    for name in names_scored if place[:2] in layers else ():
                        if name not in bodies:
                            self._miss("body", place, name, bodies)
                if variant.faults is not None and Path(variant.faults).is_file():
                    goal = next((f"{at[1]}-{seed}" for at in layers if at[:1] == ("tasks",)), "*")
                    self.problems += check_planted(Path(variant.faults), compiled, catalogue, library, goal=goal)
        return self._graphs.get(key, ())

    def _compile(
        self, graph: Path, catalogue: Catalogue, variant: Variant, layers: Mapping[Address, Variant]
    ) -> GoalGraph:
        """A goal graph with what the layers set; raises DefinitionError, of these values where they stand."""
        try:
            return read_goal_graph(graph, catalogue, make_overrides(variant))
        except DefinitionError as error:
            places = {key: (*place, "set", key) for place, layer in layers.items() for key in layer.set}
            found = [
                replace(each, address=self._located.address_of(places[each.address]))
                if each.address in places
                else each
                for each in error.problems
            ]
            raise DefinitionError(found) from error

    def check_asked(self, orders: Sequence[Order]) -> None:
        """Whether what is asked for can be: axes, their values, parts, and a bound."""
        axes = {axis: {getattr(order, name) for order in orders} for axis, name in BY_NAME.items()}
        parts = {part for order in orders for part in order.score}
        for index, asked in enumerate(self._suite.asked):
            for key, where in (("where", asked.where), ("than", asked.than or {})):
                for axis, value in where.items():
                    if axis not in axes:
                        self._miss("axis", ("asked", index, key, axis), axis, axes)
                    elif value not in axes[axis]:
                        self._miss(axis, ("asked", index, key, axis), value, axes[axis])
            if asked.part and asked.part not in parts and asked.figure is not Figure.STAGE_MS:
                self._miss("part", ("asked", index, "part"), asked.part, parts)
            if (asked.at_least is None) == (asked.at_most is None):
                expected = "one of the keys at_least and at_most"
                self.problems.append(self._located.problem("MISSING_VALUE", ("asked", index), "none or both", expected))
            for key in ("at_least", "at_most") if asked.figure in SHARES else ():
                if abs(bound := getattr(asked, key) or 0.0) > 1.0:
                    hint = f"For percent write {bound / 100:g}."
                    expected = "a share, of 1 at most"
                    self.problems.append(
                        self._located.problem("INVALID_VALUE", ("asked", index, key), f"{bound:g}", expected, hint)
                    )

    def _check_layer(self, place: Address, variant: Variant) -> None:
        if variant.repair is not None:
            with self._noting():
                load_repair(variant.repair, self._located.address_of((*place, "repair")))
        for name in variant.files.keys() - SETTINGS_FILES.keys():
            self._miss("settings file", (*place, "files", name), name, SETTINGS_FILES)
        if variant.environment is not None and variant.environment not in self._suite.environments:
            place = (*place, "environment")
            self._miss("environment", place, variant.environment, self._suite.environments)

    def _check_files(self, library: Library, layers: Mapping[Address, Variant]) -> None:
        """Whether settings files are sound with what the layers change in them."""
        for name, model in SETTINGS_FILES.items():
            changes: Fields = {}
            origins: dict[Address, tuple[Located, Address]] = {}
            for place, variant in layers.items():
                for key, value in variant.files.get(name, {}).items():
                    changes[key] = value
                    origins[tuple(key.split("."))] = (self._located, (*place, "files", name, key))
            pristine = next((p for root in library.roots if (p := root / "protocol" / name).is_file()), None)
            if changes and pristine is not None:
                with self._noting():
                    validate(model, Located(change(read_yaml(pristine).data, changes), str(pristine), {}, origins))

    def _find(self, name: str, place: Address, folder: str) -> str:
        """A file that the suite names: beside it, else in the library; the path beside it where there is none."""
        beside = Path(self._located.source).resolve().parent / name
        roots = Library.open(Path.cwd()).roots
        places = (p for root in roots for p in (root / name, root / folder / name, root / folder / f"{name}.yaml"))
        found = next((path for path in (beside, *places) if path.is_file()), None)
        if found is None:
            self._miss("file", place, name, {p.stem for root in roots for p in (root / folder).glob("*.yaml")})
        return str((found or beside).resolve())

    @contextmanager
    def _noting(self) -> Iterator[None]:
        """Keep the problems of what the block reads."""
        try:
            yield
        except DefinitionError as error:
            self.problems += error.problems

    def _miss(self, kind: str, place: Address, name: str, possible: Iterable[str]) -> None:
        self.problems.append(self._located.unknown(kind, place, name, possible))


def _read_catalogue(graph: Path, *, runs_python: bool) -> tuple[Catalogue, Library]:
    """What a goal graph can use, as in a workspace that is made for it."""
    library = Library.open(find_project(graph), Path.cwd())
    if runs_python:
        load_predicates(library.iter_predicates())
    return Catalogue.read(library), library
