"""Check authored files: find the kind of each, check it with the reader that will read it, report every problem.

There is no second parser: each kind is checked by the module that owns it, so that lint and run cannot disagree. What
is checked may come from elsewhere: the Python of its skills is executed only when asked for.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from phyagentos.assembly.project import FOLDERS, get_settings, open_library, read_limits
from phyagentos.assembly.skill_checks import check_arguments, check_skill
from phyagentos.errors import DefinitionError, Problem, format_hint, format_names
from phyagentos.operations.references import (
    Names,
    iter_of_graph,
    iter_of_settings,
    iter_of_skill,
    iter_of_target,
    iter_policy_misfits,
    iter_unknown,
)
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_target, read_target_registry
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.protocol.capabilities.targets import TARGETS, TargetProfile, find_unshared, is_beside
from phyagentos.protocol.capabilities.trees import Tree, iter_short_references, load_tree, read_tree
from phyagentos.protocol.documents.schema import Address, read_text, read_yaml
from phyagentos.protocol.predicates.project_predicates import load_predicates, name_option
from phyagentos.protocol.settings.perception import Sensing, read_perception
from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.protocol.settings.settings_files import SETTINGS_FILES, check_settings
from phyagentos.protocol.workspace.workspace import MARKER, Workspace
from phyagentos.store.document_registry import FORMATS, check_document

if TYPE_CHECKING:
    from phyagentos.agent.goals.catalogue import Catalogue
    from phyagentos.agent.goals.graph import GoalGraph


class FileKind(StrEnum):
    """What an authored file can be."""

    GOAL_GRAPH = "goal graph"
    WANTED = "goal without a plan"
    TREE = "tree"
    SKILL = "skill"
    SCENE = "scene"
    TARGET = "target"
    FAULTS = "faults"
    SUITE = "suite"
    SETTINGS = "settings"
    DOCUMENT = "protocol document"


LIKELY_MS = 5000.0  # a time from which on milliseconds were meant, rather than seconds
_KEYS = {
    "goal": FileKind.GOAL_GRAPH,
    "tree": FileKind.TREE,
    "scene": FileKind.SCENE,
    "target": FileKind.TARGET,
    "faults": FileKind.FAULTS,
    "draw": FileKind.FAULTS,
    "suite": FileKind.SUITE,
}
_FOLDERS = {
    "goal_graphs": FileKind.GOAL_GRAPH,
    "trees": FileKind.TREE,
    "scenes": FileKind.SCENE,
    "robots": FileKind.TARGET,
    "faults": FileKind.FAULTS,
}


Check = Callable[[Path], object]


class LintReport(msgspec.Struct, frozen=True, kw_only=True):
    """What `paos lint --json` prints; a warning names what a sound file leaves undecided, or says in an old form."""

    checked: tuple[str, ...]
    problems: tuple[Problem, ...]
    warnings: tuple[Problem, ...]


def lint_paths(paths: Iterable[Path], *, runs_python: bool = False, check_suite: Check | None = None) -> LintReport:
    """Check files and, recursively, folders, in the order of `paths`, each file once.

    With `runs_python`, the leaves of skills are executed, so that their ports are checked as well; suites are checked
    where `check_suite` is given, as by `bench.matrix.compile_suite`.
    """
    files = (file for path in paths for file in (iter_authored_files(path) if path.is_dir() else [path]))
    checked = tuple(dict.fromkeys(files))
    return LintReport(
        checked=tuple(map(str, checked)),
        problems=_keep_first(
            checked,
            (each for file in checked for each in lint_file(file, runs_python=runs_python, check_suite=check_suite)),
        ),
        warnings=tuple(each for file in checked for each in find_warnings(file)),
    )


def _check_settings(path: Path, library: Library) -> list[Problem]:
    """Of a workspace, against its own library."""
    is_of_workspace = (path.parent / MARKER).is_file()
    names = Names(Workspace.open(path.parent).library() if is_of_workspace else library, path.parent)
    return [*iter_unknown(read_yaml(path), iter_of_settings(check_settings(path), names))]


def _check_model(path: Path, profile: TargetProfile) -> list[Problem]:
    """What `paos robot check` finds, where the model is here; one beside the profile may come with another robot."""
    from phyagentos.runtime.models.sources import require_models
    from phyagentos.runtime.motion.profile_checks import check_profile

    if not profile.model or profile.driver:
        return []
    if is_beside(profile.model):
        is_here = (path.parent / profile.model).is_file()
        is_misspelt = bool(format_hint(profile.model, [each.name for each in path.parent.iterdir()]))
        return check_profile(path) if is_here or is_misspelt else []
    try:
        require_models(profile, path.parent)
    except DefinitionError:
        return []
    return check_profile(path)


def _keep_first(files: Sequence[Path], problems: Iterable[Problem]) -> tuple[Problem, ...]:
    """Each problem once, at the path as it was given: a suite finds those of its goal graphs too, by whole paths."""
    given = {os.path.realpath(file): str(file) for file in files}
    kept = dict[Problem, None]()
    for each in problems:
        file, mark, place = each.address.partition(":")
        kept[msgspec.structs.replace(each, address=f"{given.get(file, file)}{mark}{place}")] = None
    return tuple(kept)


def iter_authored_files(folder: Path) -> Iterator[Path]:
    """Every authored file under a folder, sorted; prose, workspaces' data and hidden folders are passed over."""
    for path in sorted(folder.rglob("*")):
        hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
        if not hidden and path.is_file() and path.suffix in {".yaml", ".yml", ".md"} and find_kind(path) is not None:
            yield path


def find_warnings(path: Path) -> list[Problem]:
    """What a sound goal graph may leave undecided, and what a tree says as it was said before; else nothing."""
    from phyagentos.agent.goals.catalogue import Catalogue
    from phyagentos.agent.goals.graph import read_goal_graph

    try:
        match find_kind(path):
            case FileKind.GOAL_GRAPH:
                catalogue = Catalogue.read(library := open_library(path))
                graph = read_goal_graph(path, catalogue)
                rig_warnings = _iter_rig_warnings(path, graph, catalogue, library)
                return [*graph.warnings, *_iter_overlong(path, graph, library), *rig_warnings]
            case FileKind.TREE:
                return list(iter_short_references(read_tree(path)))
    except DefinitionError:
        pass  # `lint_file` has its problems
    return []


def _iter_overlong(path: Path, graph: "GoalGraph", library: Library) -> Iterator[Problem]:
    """Times that safety.yaml allows no session of the target, so that preflight would refuse it."""
    limits, located, seen = (
        read_limits(library, *{each.target for each in graph.choices.values()}).targets,
        read_yaml(path),
        set[Address](),
    )
    for name, node in graph.nodes.items():
        target, given_s = graph.choices[name].target, node.spec.timeout_s or graph.spec.defaults.timeout_s
        at: Address = (*node.path, "timeout_s") if node.spec.timeout_s else ("defaults", "timeout_s")
        allowed_s = limits[target].session_duration_max.value if target in limits else None
        if isinstance(allowed_s, float | int) and given_s > allowed_s and at not in seen:
            is_of_ms = given_s >= LIKELY_MS
            hint = f"For milliseconds write {given_s / 1000:g}." if is_of_ms else "Shorten it, or split the session."
            seen.add(at)
            yield located.problem(
                "SESSION_TOO_LONG", at, f"{given_s:g} s", f"at most {allowed_s:g} s for {target!r} by safety.yaml", hint
            )


def _iter_rig_warnings(path: Path, graph: "GoalGraph", catalogue: "Catalogue", library: Library) -> Iterator[Problem]:
    """What the cameras of the project cannot tell; nothing where the simulator is read instead."""
    from phyagentos.operations.rig_warnings import Rig, iter_rig_warnings

    sensors, perception = (get_settings(name, library, None) for name in ("sensors.yaml", "perception.yaml"))
    scene = catalogue.find_scene(graph.spec.scene)
    if sensors and perception and scene and read_perception(perception).sensing is Sensing.PERCEIVED:
        yield from iter_rig_warnings(graph, read_yaml(path), Rig(scene, read_sensors(sensors)))


def lint_file(
    path: Path, *, runs_python: bool = False, library: Library | None = None, check_suite: Check | None = None
) -> list[Problem]:
    """Every problem of one file, seen from its project or from a given library; an unknown kind is one."""
    try:
        read_text(path)  # what cannot be read has no kind, and its path may lead nowhere
    except DefinitionError as error:
        return list(error.problems)
    library = library or open_library(path)
    try:
        if runs_python:
            load_predicates(library.iter_predicates())
        kind = find_kind(path)
        if kind is None:
            read_yaml(path)  # a syntax error is the better message
            keys = _read_keys(path)
            known = ", ".join(f"{key!r} ({kind})" for key, kind in _KEYS.items())
            found = f"top-level keys {', '.join(keys) or '(none)'}"
            expected = f"one of the keys {known}, a SKILL.md, a protocol document or a settings file"
            hint = next((hint for key in keys if (hint := format_hint(key, _KEYS))), "")
            return [Problem("INVALID_VALUE", f"{path}:1:1", found, expected, hint)]
        if kind is FileKind.SUITE and check_suite is not None:
            check_suite(path)
        problems = _check(kind, path, library, runs_python=runs_python)
        return name_option(problems, library.iter_predicates())
    except DefinitionError as error:
        return name_option(error.problems, library.iter_predicates())


def _find_call_problems(tree: Tree, library: Library) -> Sequence[Problem]:
    """Of the robot that its calls fit best, of those whose procedures are written down."""
    from phyagentos.runtime.execution.call_check import iter_own_problems, read_procedures

    files = (file for root in library.roots for file in sorted(root.glob("robots/*/procedures.json")))
    found = (list(iter_own_problems(tree, read_procedures(file), file.parent.name)) for file in files)
    return min(found, key=len, default=())


def find_kind(path: Path) -> FileKind | None:
    """The kind of a file, by its name, then by its first keys, then by its folder."""
    if path.suffix == ".md":
        known = {"SKILL.md": FileKind.SKILL} | dict.fromkeys(FORMATS, FileKind.DOCUMENT)
        return known.get(path.name)
    if path.name in SETTINGS_FILES:
        return FileKind.SETTINGS
    from phyagentos.agent.goals.spec import is_wanted

    keys = _read_keys(path)
    if is_wanted(dict.fromkeys(keys)):  # without `accept`, a graph that is only begun
        return FileKind.WANTED
    found = next((kind for key, kind in _KEYS.items() if key in keys), None)
    if found is not None:
        return found
    whole = path.resolve() if path.exists() else path  # a link to itself leads nowhere
    parents = [part for part in whole.parts[:-1] if part in FOLDERS]
    kind = _FOLDERS.get(parents[-1]) if parents else None
    return None if kind is FileKind.TARGET and path.name != "target.yaml" else kind  # a driver's own settings


def find_other_kind(path: Path, wanted: FileKind) -> list[Problem]:
    """The problem of a file that is of another kind than is asked for; none where its kind is not known."""
    kind = find_kind(path)
    if kind in (None, wanted):
        return []
    folder = next(name for name, each in _FOLDERS.items() if each is wanted)
    names = {each.stem for root in open_library(path).roots for each in (root / folder).glob("*.yaml")}
    return [Problem("INVALID_VALUE", f"{path}:1:1", f"a file of kind {kind}", f"{wanted}, as {format_names(names)}")]


def _read_keys(path: Path) -> list[str]:
    try:
        data: Any = read_yaml(path).data
    except DefinitionError:
        return []
    return [str(key) for key in data] if isinstance(data, dict) else []


def _check(kind: FileKind, path: Path, library: Library, *, runs_python: bool) -> Sequence[Problem]:
    """What its reader finds wrong; raises DefinitionError where that cannot even read it."""
    from phyagentos.agent.goals.catalogue import Catalogue

    match kind:
        case FileKind.DOCUMENT:
            check_document(read_text(path), path.name, str(path))
            if path.name == TARGETS.file:
                return find_unshared(list(read_target_registry(path).values()))
        case FileKind.SETTINGS:
            return _check_settings(path, library)
        case FileKind.GOAL_GRAPH:
            from phyagentos.agent.goals.graph import check_goal_graph, read_goal_graph

            if unsound := check_goal_graph(path, catalogue := Catalogue.read(library)):
                return unsound
            graph, located = read_goal_graph(path, catalogue), read_yaml(path)
            unknown = iter_unknown(located, iter_of_graph(graph, Names(library, path.parent)))
            return [*check_arguments(graph, located, catalogue, library), *unknown]
        case FileKind.WANTED:
            from phyagentos.agent.planning.domain import read_wanted

            read_wanted(path, Catalogue.read(library))
        case FileKind.SKILL:
            if wrong := check_skill(path, library):
                return wrong
            skill, located = read_skill(path)
            names = Names(library, path.parent)
            unknown = iter_unknown(located, iter_of_skill(skill, names))
            return [*unknown, *iter_policy_misfits(skill, located, names)]
        case FileKind.TREE:
            from phyagentos.runtime.execution.leaf_registry import build_registry, read_registry
            from phyagentos.runtime.execution.tree_check import check_loaded_tree

            tree, problems = load_tree(path)
            registry = build_registry(library) if runs_python else read_registry(library)
            found = check_loaded_tree(tree, library, registry) if tree is not None else ()
            return [*problems, *found, *(_find_call_problems(tree, library) if tree is not None else ())]
        case FileKind.SCENE:
            from phyagentos.runtime.models.scene_start import find_start_problems

            return find_start_problems(path)
        case FileKind.TARGET:
            names, own = Names(library, path.parent), read_target(path)
            known = {**names.catalogue.targets, own.target: own}
            unshared = (each for each in find_unshared([*known.values()]) if each.address.startswith(f"{own.target}/"))
            return [*iter_unknown(read_yaml(path), iter_of_target(own, names)), *unshared, *_check_model(path, own)]
        case FileKind.FAULTS:
            return [*Names(library, path.parent).iter_misses(path)]
    return ()
