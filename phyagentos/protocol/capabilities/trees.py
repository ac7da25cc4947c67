"""Behaviour trees as people write them: `trees/<name>.yaml` in, frozen nodes out.

Structure is checked here, ports where leaves are known. `${name}` refers to a key of the tree, else a value is literal;
`$name`, as it was written before, means the same. A mapping given to a port of a leaf is as many ports as it has
fields, by their paths: `goal: {poses: [{x: 1}]}` is `goal.poses.0.x: 1`. A tree without `inputs` or `outputs` has
those of the skill of its name.
"""

import itertools
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import pydantic
from typing_extensions import override

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.skill_runtimes import Output, Parameter, read_skill
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Address, Authored, Located, read_yaml, salvage, show_value, validate

NODES_MAX, LEVELS_MAX = 20_000, 100  # of a tree with its subtrees in their places
_OF_PORTS = {"type", "description", "optional", "default"}
PortType = Literal[
    "entity",
    "entities",
    "place",
    "point",
    "points",
    "posture",
    "number",
    "integer",
    "string",
    "boolean",
    "pose",
    "approach",
    "approaches",
    "payload",
]
REFERENCE = re.compile(r"\$\{([a-z][a-z0-9_]*)\}")
_SHORT = re.compile(r"\$([A-Za-z0-9_]*)")  # of before; still read, with a warning


class TreePort(Authored):
    """A typed input or output of a tree."""

    type: PortType
    description: str = ""
    optional: bool = False
    default: str | float | bool | None = None


class TreeHeader(Authored):
    """One `trees/<name>.yaml`."""

    tree: str = pydantic.Field(pattern=r"^[a-z][a-z0-9_/]*$", description="The file's name without suffix.")
    description: str
    inputs: dict[str, TreePort] = pydantic.Field({}, description="Those of the skill of the tree's name by default.")
    outputs: dict[str, TreePort] = {}
    root: Fields | str = pydantic.Field(description="One node; every node is a mapping with one key.")


class CompositeForm(Authored):
    """Body of `sequence`, `fallback` and their reactive forms."""

    children: list[Any] = pydantic.Field(min_length=1)
    name: str = ""


class ParallelForm(CompositeForm):
    """Body of `parallel`: succeeds when all or when one child does."""

    policy: Literal["all", "one"] = "all"


class InvertForm(Authored):
    """Body of `invert`."""

    child: Any
    name: str = ""


class RetryForm(InvertForm):
    """Body of `retry`."""

    attempts: int = pydantic.Field(ge=1)


class RepeatForm(InvertForm):
    """Body of `repeat`."""

    times: int = pydantic.Field(ge=1)


class TimeoutForm(InvertForm):
    """Body of `timeout` and `cooldown`; seconds of simulated time."""

    seconds: float = pydantic.Field(gt=0.0)


class ForEachForm(InvertForm):
    """Body of `for_each`: the key that takes each element in turn, and the list, by its key or as a literal."""

    each: str = pydantic.Field(pattern=r"^\$(\{[a-z][a-z0-9_]*\}|[a-z][a-z0-9_]*)$")
    values: str | list[Any] = pydantic.Field(alias="in")


class SubtreeForm(Authored):
    """Body of `subtree`: another tree, its inputs and outputs wired to keys of this one."""

    tree: str
    wiring: Fields = pydantic.Field(default={}, alias="with")
    name: str = ""


class NodeKind(StrEnum):
    """The node kinds of the format; every other key is the name of a leaf."""

    SEQUENCE = "sequence"
    """Children in order, until one fails."""
    FALLBACK = "fallback"
    """Children in order, until one succeeds."""
    REACTIVE_SEQUENCE = "reactive_sequence"
    """A sequence that begins again at its first child with every tick."""
    REACTIVE_FALLBACK = "reactive_fallback"
    """A fallback that begins again at its first child with every tick."""
    PARALLEL = "parallel"
    """Children together."""
    RETRY = "retry"
    """The child again when it fails."""
    REPEAT = "repeat"
    """The child again when it succeeds."""
    FOR_EACH = "for_each"
    """The child once for each element of a list."""
    TIMEOUT = "timeout"
    """The child, for so long."""
    COOLDOWN = "cooldown"
    """The child; for so long after it ended, failure without it."""
    INVERT = "invert"
    """Success and failure of the child exchanged."""
    CONDITION = "condition"
    """A predicate, evaluated once."""
    SUBTREE = "subtree"
    """Another tree in this place."""
    LEAF = "leaf"
    """A leaf of the registry."""


_FORMS: dict[NodeKind, type[Authored]] = {
    NodeKind.SEQUENCE: CompositeForm,
    NodeKind.FALLBACK: CompositeForm,
    NodeKind.REACTIVE_SEQUENCE: CompositeForm,
    NodeKind.REACTIVE_FALLBACK: CompositeForm,
    NodeKind.PARALLEL: ParallelForm,
    NodeKind.RETRY: RetryForm,
    NodeKind.REPEAT: RepeatForm,
    NodeKind.FOR_EACH: ForEachForm,
    NodeKind.TIMEOUT: TimeoutForm,
    NodeKind.COOLDOWN: TimeoutForm,
    NodeKind.INVERT: InvertForm,
    NodeKind.SUBTREE: SubtreeForm,
}


@dataclass(frozen=True, slots=True)
class Reference:
    """`${name}`: a key of the tree."""

    key: str

    @override
    def __str__(self) -> str:
        return f"${{{self.key}}}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """One node of an authored tree.

    Attributes:
        name: Unique among its siblings; part of the path in traces.
        address: Where it stands in the file's data.
        type: Leaf type or name of the subtree, else the kind.
        wiring: Port -> `Reference` or literal, of leaves and subtrees; `each` and `in` of `for_each`.
        amount: Attempts of `retry`, times of `repeat`, seconds of `timeout` and `cooldown`.
        policy: `all` or `one`, of `parallel`.
        text: Predicate of `condition`.
    """

    kind: NodeKind
    name: str
    address: Address = field(compare=False)
    children: tuple["Node", ...] = ()
    type: str = ""
    wiring: Mapping[str, Any] = field(default_factory=dict)
    amount: float = 0.0
    policy: str = ""
    text: str = ""


@dataclass(frozen=True, slots=True)
class Tree:
    """One authored tree: its header, its nodes and where they stand."""

    header: TreeHeader
    root: Node
    located: Located


def read_tree(path: Path) -> Tree:
    """One tree file, parsed again only when changed; raises DefinitionError with every problem at file:line:column."""
    tree, problems = load_tree(path)
    if tree is None or problems:
        raise DefinitionError(problems)
    return tree


def load_tree(path: Path) -> tuple[Tree | None, tuple[Problem, ...]]:
    """A tree as far as it can be read, and every structural problem; raises DefinitionError for what is no YAML."""
    skill = _find_skill(path)
    return _load_tree(path, _read_state(path), skill, _read_state(skill))


@lru_cache(maxsize=256)
def _load_tree(
    path: Path, _state: tuple[int, int], skill: Path | None, _skill_state: tuple[int, int]
) -> tuple[Tree | None, tuple[Problem, ...]]:
    tree, problems = parse_tree(read_yaml(path), path)
    missing = {"inputs", "outputs"} - tree.header.model_fields_set if tree is not None else set()
    if tree is None or skill is None or not missing:
        return tree, problems
    try:
        declared = read_skill(skill)[0]
    except DefinitionError as error:
        return tree, (*problems, *error.problems)
    if declared.tree != tree.header.tree:
        return tree, problems
    found = {}
    for key in missing:
        ports: Mapping[str, Parameter | Output] = declared.parameters if key == "inputs" else declared.outputs
        found[key] = {name: TreePort(**each.model_dump(include=_OF_PORTS)) for name, each in ports.items()}
    return replace(tree, header=tree.header.model_copy(update=found)), problems


def _find_skill(path: Path) -> Path | None:
    """The skill of the tree's name: beside it, else the one that ships."""
    root = next((parent.parent for parent in path.parents if parent.name == "trees"), None)
    if root is None:
        return None
    name = path.relative_to(root / "trees").with_suffix("")
    files = (each / "skills" / name / "SKILL.md" for each in (root, find_shipped_root()))
    return next((file for file in files if file.is_file()), None)


def _read_state(path: Path | None) -> tuple[int, int]:
    """What changes with a file: when it was written [ns], and its size [bytes]."""
    try:
        found = path.stat() if path is not None else None
    except OSError:
        return 0, 0
    return (found.st_mtime_ns, found.st_size) if found is not None else (0, 0)


def parse_tree(located: Located, path: Path | None = None) -> tuple[Tree | None, tuple[Problem, ...]]:
    """As `load_tree`, of data in memory; its name is compared with that of a file where it has one."""
    header, problems = salvage(TreeHeader, located)
    if header is None or "root" not in located.data:  # perhaps misspelt
        return None, tuple(problems)
    parts = header.tree.split("/")
    if path is not None and path.as_posix().removesuffix(".yaml").split("/")[-len(parts) :] != parts:
        name = "/".join(path.with_suffix("").parts[-len(parts) :])
        expected, hint = f"the file's name {name!r}", f"Write {name!r}, or rename the file."
        problems.append(located.problem("INVALID_VALUE", ("tree",), repr(header.tree), expected, hint))
        header = header.model_copy(update={"tree": name})  # by which skills know its ports
    root = _build(located, ("root",), problems, default_name=parts[-1])
    tree = Tree(header=header, root=root, located=located) if root is not None else None
    return tree, (*problems, *(_iter_unclosed(tree) if tree is not None else ()))


def _iter_unclosed(tree: Tree) -> Iterator[Problem]:
    """Where a text begins a reference and is none."""
    hint = "Write small letters, digits and '_' between both brackets."
    for node in iter_nodes(tree.root):
        place = (*node.address, "with") if node.kind is NodeKind.SUBTREE else node.address
        for port, value in node.wiring.items():
            if isinstance(value, str) and "${" in REFERENCE.sub("", value):
                at = (*place, *split_path(port))
                yield tree.located.problem("INVALID_VALUE", at, repr(value), 'a reference, "${name}"', hint)


def iter_nodes(node: Node) -> Iterator[Node]:
    """The node and everything below it, parents first."""
    yield node
    for child in node.children:
        yield from iter_nodes(child)


def list_subtrees(tree: Tree) -> list[str]:
    """Names of the trees that stand in it, as often as they do."""
    return [node.type for node in iter_nodes(tree.root) if node.kind is NodeKind.SUBTREE]


def find_oversize(tree: Tree, library: Library) -> tuple[str, Problem] | None:
    """The name of the tree, or else of one below it, that is too large or deep with its subtrees in their places."""
    sizes, begun, waiting = dict[str, tuple[int, int]](), set[str](), [(tree, 1)]  # nodes and levels by name
    while waiting:
        (top, depth), name = waiting[-1], waiting[-1][0].header.tree
        below = list_subtrees(top)
        if name not in begun and depth <= LEVELS_MAX + 1:
            begun.add(name)
            loaded = (_find_tree(each, library) for each in dict.fromkeys(below) if each not in begun)
            waiting += [(each, depth + 1) for each in loaded if each is not None]
            continue
        waiting.pop()
        inner = [sizes.get(each, (0, 0)) for each in below]
        nodes = sum(1 for _ in iter_nodes(top.root)) + sum(each for each, _ in inner)
        levels = 1 + max((each for _, each in inner), default=0)
        sizes[name] = nodes, levels
        if nodes > NODES_MAX or levels > LEVELS_MAX or depth > LEVELS_MAX + 1:
            found = f"{nodes} nodes in {levels} levels of trees"
            hint = "Do it in several skills, or by 'repeat' or 'for_each'."
            expected = f"at most {NODES_MAX} in {LEVELS_MAX}"
            return name, top.located.problem("TOO_LARGE", ("root",), found, expected, hint)
    return None


def _find_tree(name: str, library: Library) -> Tree | None:
    try:
        return load_tree(library.get_tree(name))[0] if library.has_tree(name) else None
    except DefinitionError:
        return None


def iter_short_references(tree: Tree) -> Iterator[Problem]:
    """Where a reference stands as it was written before."""
    for node in iter_nodes(tree.root):
        data = tree.located.at(node.address)
        fields = data if isinstance(data, dict) else {}
        places = [((*node.address, port), value) for port, value in fields.items()]
        places += [((*node.address, "with", port), value) for port, value in dict(fields.get("with") or {}).items()]
        for place, value in places:
            if isinstance(value, str) and _SHORT.fullmatch(value):
                yield tree.located.problem("INVALID_VALUE", place, value, f'"${{{value[1:]}}}"')


def find_references(text: str) -> tuple[str, ...]:
    """The names in `${name}` of a predicate, in order."""
    return tuple(REFERENCE.findall(text))


def _build(located: Located, address: Address, problems: list[Problem], default_name: str = "") -> Node | None:
    data = located.at(address)
    is_bare = isinstance(data, str)  # a leaf without ports
    if is_bare:
        data = {data: None}
    if not isinstance(data, dict) or len(data) != 1:
        shown = f"a mapping with keys {', '.join(map(str, data))}" if isinstance(data, dict) else show_value(data)
        expected = "a mapping with one key: a node kind or a leaf"
        hint = "Write each as an entry of its own, without brackets." if data else "Write its name."
        problems.append(located.problem("INVALID_VALUE", address, shown, expected, hint))
        return None
    key, body = next(iter(data.items()))
    place = address if is_bare else (*address, key)
    if key == NodeKind.CONDITION:
        return _build_condition(located, place, body, problems, default_name)
    if key in _FORMS:
        return _build_control(located, NodeKind(key), place, problems, default_name)
    return _build_leaf(located, str(key), place, body, problems, default_name)


def _build_condition(
    located: Located, place: Address, body: Any, problems: list[Problem], default_name: str
) -> Node | None:
    if not isinstance(body, str) or not body.strip():
        problems.append(located.problem("INVALID_VALUE", place, show_value(body), "a predicate in quotes"))
        return None
    return Node(kind=NodeKind.CONDITION, type="condition", name=default_name or "condition", address=place, text=body)


def _build_leaf(
    located: Located, leaf: str, place: Address, body: Any, problems: list[Problem], default_name: str
) -> Node | None:
    if body is not None and not isinstance(body, dict):
        problems.append(
            located.problem("INVALID_VALUE", place, show_value(body), "a mapping of ports", "Write {PORT: VALUE}.")
        )
        return None
    fields = (field for port, given in (body or {}).items() for field in _flatten(str(port), given))
    wiring = {path: _parse_value(value) for path, value in fields}
    name = _check_name(located, (*place, "name"), wiring.pop("name", ""), problems)
    return Node(kind=NodeKind.LEAF, type=leaf, name=name or default_name or leaf, address=place, wiring=wiring)


def _flatten(path: str, value: object) -> Iterator[tuple[str, object]]:
    """The fields of a mapping, or of a list with mappings or references, by their paths; any other value by its own."""
    if isinstance(value, dict):
        for name, each in value.items():
            yield from _flatten(f"{path}.{name}", each)
    elif isinstance(value, list) and any(isinstance(each, dict) or REFERENCE.fullmatch(str(each)) for each in value):
        for index, each in enumerate(value):
            yield from _flatten(f"{path}.{index}", each)
    else:
        yield path, value


def split_path(path: str) -> Address:
    """The steps of a port's path, as in the file: of `goal.poses.0.x` they are `goal`, `poses`, 0 and `x`."""
    return tuple(int(step) if step.isdecimal() else step for step in path.split("."))


def _check_name(located: Located, place: Address, name: object, problems: list[Problem]) -> str:
    """The name of a node, as it is where it can be a step of a path: '/' parts the steps, and a path is one line."""
    if name is None or (isinstance(name, str) and "/" not in name and (name.isprintable() and name == name.strip())):
        return name or ""
    fitting = re.sub(r"[^\w.-]+", "_", str(name)).strip("_")
    hint = f"Write '{fitting}'." if fitting else "Leave 'name' out."
    problems.append(located.problem("INVALID_VALUE", place, show_value(name), "a name of one line without '/'", hint))
    return fitting


def _build_control(
    located: Located, kind: NodeKind, place: Address, problems: list[Problem], default_name: str
) -> Node | None:
    try:
        form: Any = validate(_FORMS[kind], located, place)
    except DefinitionError as error:
        problems.extend(error.problems)
        return None
    children: tuple[Node, ...] = ()
    if isinstance(form, CompositeForm):
        built = [_build(located, (*place, "children", index), problems) for index in range(len(form.children))]
        children = _name_apart([child for child in built if child is not None])
    elif isinstance(form, InvertForm):
        child = _build(located, (*place, "child"), problems)
        children = (child,) if child is not None else ()
    name = _check_name(located, (*place, "name"), form.name, problems)
    subtree = form.tree if isinstance(form, SubtreeForm) else ""
    wiring = {port: _parse_value(value) for port, value in form.wiring.items()} if subtree else {}
    if isinstance(form, ForEachForm):
        wiring = {"each": _parse_value(form.each), "in": _parse_value(form.values)}
    return Node(
        kind=kind,
        type=subtree or kind.value,
        name=name or default_name or subtree.rsplit("/", 1)[-1] or kind.value,
        address=place,
        children=children,
        wiring=wiring,
        amount=float(next((getattr(form, key) for key in ("attempts", "times", "seconds") if hasattr(form, key)), 0.0)),
        policy=getattr(form, "policy", ""),
    )


def _name_apart(children: list[Node]) -> tuple[Node, ...]:
    """Give siblings of the same name a number that none of them bears, so that paths in traces are unique."""
    taken, seen = {child.name for child in children}, Counter[str]()
    for index, child in enumerate(children):
        seen[child.name] += 1
        if seen[child.name] > 1:
            names = (f"{child.name}.{number}" for number in itertools.count(seen[child.name]))
            children[index] = replace(child, name=next(name for name in names if name not in taken))
            taken.add(children[index].name)
    return tuple(children)


def _parse_value(value: Any) -> Any:
    if isinstance(value, str) and (found := REFERENCE.fullmatch(value) or _SHORT.fullmatch(value)):
        return Reference(found[1])
    if isinstance(value, list):
        return tuple(value)
    return value
