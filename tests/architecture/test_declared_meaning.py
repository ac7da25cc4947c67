"""No module decides by what a predicate, a skill's parameter or a leaf is called: it reads what these declare."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import phyagentos
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.protocol.predicates.library import get_predicate_library
from phyagentos.runtime.execution.leaf_registry import build_registry

ROOT = Path(phyagentos.__file__).parent
DEFINING = (  # what ships is defined there, or words of people become predicates
    "protocol/predicates/builtins.py",
    "protocol/predicates/library.py",
    "agent/understanding/clauses.py",
    "agent/understanding/keeping.py",
    "agent/understanding/destinations.py",
    "agent/understanding/discourse.py",
    "agent/understanding/nouns.py",
    "agent/understanding/transfers.py",
    "runtime/execution/leaves/",
    "runtime/execution/first_motions.py",
)
OF_TYPES = {"place", "posture"}  # what a parameter takes, see `Parameter.type`
ELSEWHERE = {  # the same word for something else
    "agent/goals/checks.py": OF_TYPES,
    "agent/judging/diagnosis.py": {"metric"},  # the kind of a criterion
    "agent/planning/operators.py": {"posture"},
    "operations/schema_fields.py": {"object"},  # of JSON Schema
    "export/mcap_log.py": {"at"},  # when a line was written
    "protocol/capabilities/skill_runtimes.py": OF_TYPES,
    "protocol/documents/body_codec.py": {"on"},  # a truth value of YAML 1.1
    "runtime/policies/policy_runtime.py": {"fail"},  # what a composite is to do
    "runtime/preflight/arguments.py": OF_TYPES,
    "runtime/preflight/policy_checks.py": {"place"},
    "runtime/worker/agent_loop.py": {"wait"},  # a call of an agent
    "store/views/environment.py": {"moved"},  # a change of the world
    "protocol/sessions/trace.py": {  # bundles that were recorded before leaves declared a role
        *("locate", "look", "plan_grasp", "plan_place", "move_to", "move_linear", "move_level"),
        *("close_gripper", "verify_grasp", "attach", "open_gripper", "detach"),
    },
}
ARGUMENTS = {"parameters", "arguments", "wired", "given", "bound", "known"}  # what a skill or a leaf is given


def _list_names() -> set[str]:
    library = Library.open()
    skills = [read_skill(library.get_skill(name))[0] for name in library.names_of_skills()]
    parameters = {name for skill in skills for name in skill.parameters}
    return {*get_predicate_library().names(), *build_registry(library).names(), *parameters}


def _list_texts(node: ast.AST | None) -> list[str]:
    """String constants of an expression, or of the collection that it is."""
    match node:
        case ast.Constant(str(text)):
            return [text]
        case ast.Tuple(elements) | ast.List(elements) | ast.Set(elements):
            return [text for element in elements for text in _list_texts(element)]
        case ast.Dict(keys):
            return [text for key in keys for text in _list_texts(key)]
        case ast.Call(ast.Name("frozenset" | "set"), [argument]):
            return _list_texts(argument)
    return []


def find_decisions(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of each string that is compared, matched, or taken for the beginning of a predicate."""
    for node in ast.walk(tree):
        match node:
            case ast.Compare(left, operators, right):
                if any(isinstance(each, ast.Eq | ast.NotEq | ast.In | ast.NotIn) for each in operators):
                    yield from ((node.lineno, text) for each in (left, *right) for text in _list_texts(each))
            case ast.MatchValue(ast.Constant(str(text))):
                yield node.lineno, text
            case ast.Call(ast.Attribute(_, "startswith" | "removeprefix" | "partition" | "split"), arguments):
                texts = (text for argument in arguments for text in _list_texts(argument))
                yield from ((node.lineno, text.removeprefix("not ").removesuffix("(")) for text in texts)
            case ast.Subscript(owner, ast.Constant(str(text))) | ast.Call(
                ast.Attribute(owner, "get" | "pop"), [ast.Constant(str(text)), *_]
            ) if ast.unparse(owner).rpartition(".")[2] in ARGUMENTS:
                yield node.lineno, text
            case ast.Assign(targets, value) if all(
                isinstance(each, ast.Name) and each.id.isupper() for each in targets
            ):
                yield from ((node.lineno, text) for text in _list_texts(value) if not isinstance(value, ast.Constant))


@pytest.mark.slow
def test_no_module_decides_by_the_name_of_a_predicate_a_parameter_or_a_leaf():
    names, unused = _list_names(), {(place, word) for place, words in ELSEWHERE.items() for word in words}
    found = []
    for path in sorted(ROOT.rglob("*.py")):
        place = path.relative_to(ROOT).as_posix()
        decisions = find_decisions(ast.parse(path.read_text(encoding="utf-8")))
        for line, text in decisions if not place.startswith(DEFINING) else ():
            if text in names and text not in ELSEWHERE.get(place, ()):
                found.append(f"{place}:{line}: {text!r}")
            unused.discard((place, text))
    assert (found, sorted(unused)) == ([], [])


@pytest.mark.parametrize(
    "source",
    [
        'call.name == "inside"',
        'name in {"open", "closed"}',
        'text.startswith("holding(")',
        'match call:\n    case Call("on", _): pass',
        'PLACES = ("inside", "on")',
        'session.parameters["destination"]',
        'wired.get("near")',
        'leaf.name != "plan_grasp"',
    ],
)
def test_a_decision_by_a_name_is_found(source):
    assert {text for _, text in find_decisions(ast.parse(source))} & _list_names()
