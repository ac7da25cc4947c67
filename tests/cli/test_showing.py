"""What there is can be listed and drawn without starting anything."""

import json
import re
from functools import cache
from pathlib import Path
from xml.etree import ElementTree as ET

import jsonschema
import pytest
import yaml

from phyagentos.cli import schemas
from phyagentos.cli.outcome import ExitCode
from phyagentos.operations.listing import RETRIES
from tests.command_line import assert_ended, assert_refused

ROOT = Path(__file__).resolve().parents[2]
SCHEMAS = ROOT / "protocol" / "schemas"


def test_the_statechart_in_the_docs_is_the_table(paos):
    text = (ROOT / "docs/lifecycle.md").read_text(encoding="utf-8")
    assert paos("lifecycle", "--mermaid").out.strip() in text
    assert paos("lifecycle", "--target", "--mermaid").out.strip() in text


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("graphs", "tidy_table"),
        ("leaves", "verify_grasp"),
        ("predicates", "inside(a, b)"),
        ("scenes", "tabletop/cubes_and_trays"),
        ("skills", "pick_and_place"),
        ("targets", "panda"),
        ("trees", "pick_and_place"),
    ],
)
def test_names_are_listed_one_a_line(paos, kind, name):
    result = paos("list", kind)
    assert result.code == ExitCode.GOAL_MET
    assert name in result.out.splitlines()


def test_a_tree_is_drawn_with_its_subtrees(paos):
    text = paos("tree", "show", "pick_and_place").out
    assert "▣ pick " in text
    assert "lift · move_linear" in text


def test_a_tree_as_mermaid_has_one_edge_fewer_than_nodes(paos):
    text = paos("tree", "show", "pick_and_place", "--mermaid").out
    nodes = re.findall(r"^    n\d+[\[(]", text, re.MULTILINE)
    edges = re.findall(r"^    n\d+ --> n\d+$", text, re.MULTILINE)
    assert len(nodes) == len(edges) + 1 > 15


def test_a_tree_as_svg_is_well_formed_and_names_every_leaf(paos, tmp_path):
    path = tmp_path / "tree.svg"
    assert paos("tree", "show", ROOT / "trees/pick_and_place.yaml", "--svg", path).code == ExitCode.GOAL_MET
    root = ET.fromstring(path.read_text(encoding="utf-8"))
    texts = [element.text or "" for element in root.iter("{http://www.w3.org/2000/svg}text")]
    assert any("verify_grasp" in text for text in texts)


def test_a_tree_that_contains_itself_is_not_drawn_for_ever(paos, tmp_path):
    path = tmp_path / "trees" / "loop.yaml"
    path.parent.mkdir()
    path.write_text("tree: loop\ndescription: Round.\nroot: {subtree: {tree: loop}}\n", encoding="utf-8")
    assert_refused(paos("tree", "show", path), f"{path}:3:8: CYCLE: found loop -> loop")


KINDS = [*schemas.names_of_schemas(), *schemas.names_of_results()]


def test_no_schema_is_shipped_that_nothing_makes():
    shipped = SCHEMAS.rglob("*.schema.json")
    assert {path.relative_to(SCHEMAS).as_posix().removesuffix(".schema.json") for path in shipped} == set(KINDS)


AUTHORED = [
    *((path, "goal_graph") for path in sorted((ROOT / "goal_graphs").glob("*.yaml"))),
    *((path, "tree") for path in sorted((ROOT / "trees").rglob("*.yaml"))),
    *((path, "scene") for path in sorted((ROOT / "scenes").rglob("*.yaml"))),
    *((path, "target") for path in sorted((ROOT / "robots").rglob("target.yaml"))),
    *((path, "faults") for path in sorted((ROOT / "faults").glob("*.yaml"))),
    *((ROOT / "protocol" / f"{kind}.yaml", kind) for kind in ("safety", "sensors", "perception", "runtime_contract")),
]


class EditorLoader(yaml.SafeLoader):
    """YAML 1.2, as editors read it: `on` is a word and no truth value."""

    yaml_implicit_resolvers = {
        letter: [row for row in rows if not row[0].endswith(":bool") or letter in "tTfF"]
        for letter, rows in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }


@cache
def make_validator(kind):
    return jsonschema.Draft202012Validator(json.loads(schemas.render_schema(kind)))


@pytest.mark.parametrize(("path", "kind"), AUTHORED, ids=lambda value: getattr(value, "stem", value))
def test_an_editor_accepts_what_the_reader_accepts(path, kind):
    data = yaml.load(path.read_text(encoding="utf-8"), EditorLoader)
    make_validator(kind).validate(data)


def test_an_editor_refuses_an_unknown_key():
    data = yaml.safe_load((ROOT / "goal_graphs/tidy_table.yaml").read_text(encoding="utf-8")) | {"colour": "red"}
    with pytest.raises(jsonschema.ValidationError, match="'colour' was unexpected"):
        make_validator("goal_graph").validate(data)


def test_every_code_says_whether_trying_again_helps(paos):
    assert_ended(paos("codes"), ExitCode.GOAL_MET, out=[*RETRIES.values()])
