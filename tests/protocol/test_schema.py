"""Reading authored files: every problem at once, each at its place."""

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.protocol.schema import Authored, parse_yaml, salvage, validate


class Inner(Authored):
    size: int
    color: str = "red"


class Outer(Authored):
    name: str
    parts: dict[str, Inner] = {}


TEXT = """nmae: x
name: thing
parts:
  a: {size: 3, colour: blue}
  b: {size: big}
"""


def test_every_problem_is_told_with_its_place_and_the_nearest_name():
    with pytest.raises(DefinitionError) as caught:
        validate(Outer, parse_yaml(TEXT, "f.yaml"))
    lines = str(caught.value).splitlines()
    assert len(lines) == 3
    assert any(line.startswith("f.yaml:1:1: UNKNOWN_KEY: found 'nmae'") and "'name'?" in line for line in lines)
    assert any(line.startswith("f.yaml:4:16: UNKNOWN_KEY: found 'colour'") and "'color'?" in line for line in lines)
    assert any(line.startswith("f.yaml:5:7: INVALID_VALUE: found 'big'") for line in lines)


def test_what_is_wrong_but_not_needed_is_left_out_so_that_checks_can_go_on():
    located = parse_yaml("nmae: x\nname: thing\nparts:\n  a: {size: 3, colour: blue}\n", "f.yaml")
    model, problems = salvage(Outer, located)
    assert model == Outer(name="thing", parts={"a": Inner(size=3)})
    assert [problem.code for problem in problems] == ["UNKNOWN_KEY", "UNKNOWN_KEY"]
    assert located.data["nmae"] == "x"


def test_a_value_that_lacks_what_it_needs_is_left_out_as_a_whole():
    model, problems = salvage(Outer, parse_yaml(TEXT, "f.yaml"))
    assert model == Outer(name="thing", parts={"a": Inner(size=3)})
    assert len(problems) == 3


def test_what_the_file_itself_needs_leaves_no_model_but_every_problem():
    model, problems = salvage(Outer, parse_yaml("title: x\nparts: {a: {size: big}}\n", "f.yaml"))
    assert model is None
    assert [problem.code for problem in problems] == ["MISSING_KEY", "INVALID_VALUE", "UNKNOWN_KEY"]


def test_a_misspelt_key_stands_in_for_the_one_that_is_needed():
    model, problems = salvage(Outer, parse_yaml("nmae: x\nparts: {a: {sise: 3}, b: {size: big}}\n", "f.yaml"))
    assert model == Outer(name="x", parts={"a": Inner(size=3)})
    assert [problem.code for problem in problems].count("UNKNOWN_KEY") == 2


def test_a_sound_file_has_no_problem():
    assert salvage(Outer, parse_yaml("name: x", "f.yaml")) == (Outer(name="x"), [])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\na: 2\n", r"f.yaml:2:1: DUPLICATE_KEY: found 'a'"),
        ("a: [1\n", r"f.yaml:2:1: YAML_SYNTAX"),
        ("- 1\n", r"f.yaml:1:1: WRONG_TYPE: found list; expected a mapping \(Outer\)"),
    ],
)
def test_text_that_is_no_mapping_is_told(text, message):
    with pytest.raises(DefinitionError, match=message):
        validate(Outer, parse_yaml(text, "f.yaml"))
