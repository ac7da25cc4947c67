"""Reading authored files: every problem at once, each at its place."""

import math
from datetime import date
from typing import Annotated

import msgspec
import pydantic
import pytest
import yaml

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.skill_runtimes import Parameter, find_mismatch
from phyagentos.protocol.documents.schema import Authored, parse_yaml, salvage, validate
from phyagentos.protocol.documents.yaml_scalars import Loader


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
    assert any(line.startswith("f.yaml:1:1: UNKNOWN_NAME (key): found 'nmae'") and "'name'?" in line for line in lines)
    assert any(
        line.startswith("f.yaml:4:16: UNKNOWN_NAME (key): found 'colour'") and "'color'?" in line for line in lines
    )
    assert any(line.startswith("f.yaml:5:7: INVALID_VALUE: found 'big'") for line in lines)


KEY = "UNKNOWN_NAME (key)"


@pytest.mark.parametrize(
    ("text", "model", "labels"),
    [
        pytest.param(
            "nmae: x\nname: thing\nparts:\n  a: {size: 3, colour: blue}\n",
            Outer(name="thing", parts={"a": Inner(size=3)}),
            [KEY, KEY],
            id="what is wrong but not needed is left out so that checks can go on",
        ),
        pytest.param(
            TEXT,
            Outer(name="thing", parts={"a": Inner(size=3)}),
            [KEY, KEY, "INVALID_VALUE"],
            id="a value that lacks what it needs is left out as a whole",
        ),
        pytest.param(
            "title: x\nparts: {a: {size: big}}\n",
            None,
            ["MISSING_VALUE", "INVALID_VALUE", KEY],
            id="what the file itself needs leaves no model but every problem",
        ),
        pytest.param(
            "nmae: x\nparts: {a: {sise: 3}, b: {size: big}}\n",
            Outer(name="x", parts={"a": Inner(size=3)}),
            ["MISSING_VALUE", "MISSING_VALUE", KEY, KEY, "INVALID_VALUE"],
            id="a misspelt key stands in for the one that is needed",
        ),
    ],
)
def test_what_can_be_used_of_a_wrong_file_is_used_and_every_problem_is_told(text, model, labels):
    located = parse_yaml(text, "f.yaml")
    found, problems = salvage(Outer, located)
    assert found == model
    assert sorted(problem.label for problem in problems) == sorted(labels)
    assert located.data == parse_yaml(text, "f.yaml").data


class Painted(Authored):
    rgb: tuple[Annotated[float, pydantic.Field(le=1.0)], float, Annotated[float, pydantic.Field(le=1.0)]] = (0.0,) * 3


class Paints(Authored):
    paints: dict[str, Painted] = {}


def test_two_wrong_values_of_one_list_take_nothing_beside_it_along():
    located = parse_yaml("paints: {red: {rgb: [210, 0.1, 255]}, blue: {rgb: [0, 0, 1]}}", "f.yaml")
    found, problems = salvage(Paints, located)
    assert sorted(found.paints) == ["blue", "red"]
    assert [each.found for each in problems] == ["210", "255"]


def test_a_wrong_value_that_several_mappings_merge_is_reported_once_where_it_is_written():
    text = "paints:\n  red: &x\n    rgb: [210, 0, 0]\n  blue: {<<: *x}\n  green:\n    <<: [*x]\n"
    text += "  grey: {<<: *x, rgb: [0, 0, 5]}\n"
    with pytest.raises(DefinitionError) as refused:
        validate(Paints, parse_yaml(text, "f.yaml"))
    assert [(each.address, each.found) for each in refused.value.problems] == [
        ("f.yaml:3:11", "210"),
        ("f.yaml:7:30", "5"),
    ]


def test_an_old_number_that_aliases_repeat_is_reported_once():
    with pytest.raises(DefinitionError) as refused:
        parse_yaml("a: &x 060\nb: *x\nc: {d: *x}\n", "f.yaml")
    assert [each.address for each in refused.value.problems] == ["f.yaml:1:4"]


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("2001-99-99", r"'2001-99-99', which is no date; expected .* Quote it where it is text"),
        ("!!timestamp soon", r"'soon', which is no date"),
        ("!!int abc", r"'abc', which is no integer of 64 bits"),
        ("!!int ''", r"'', which is no integer of 64 bits"),
        ("!!float abc", r"'abc', which is no number"),
        ("!!float ''", r"'', which is no number"),
        ("!!bool abc", r"'abc', which is no truth value"),
        ("9" * 5000, r"'9{40}', which is no integer of 64 bits"),
        ("0x" + "f" * 5000, r"'0xf{38}', which is no integer of 64 bits"),
        ("18446744073709551616", r"is no integer of 64 bits"),
        ("-9223372036854775809", r"is no integer of 64 bits"),
        ("{? [p, q] : 1}", r"a list or mapping as a key"),
        ("{? {p: q} : 1}", r"a list or mapping as a key"),
        ("&x [1, *x]", r"more than 200 levels, or an alias inside of what it stands for"),
        ("&x {a: *x}", r"more than 200 levels"),
        ("[" * 2000 + "]" * 2000, r"more than 200 levels"),
        ("[" * 200_000 + "]" * 200_000, r"more than 200 levels"),
        (":".join(["1"] * 1000), r"is no integer of 64 bits"),
    ],
)
def test_a_value_that_cannot_be_read_is_told_with_its_place(value, message):
    with pytest.raises(DefinitionError, match=rf"f\.yaml:3:\d+: SYNTAX: found .*{message}"):
        parse_yaml(f"a: 1\nb: {value}\n", "f.yaml", first_line=2)


def test_every_integer_that_a_record_can_hold_is_read():
    text = "[18446744073709551615, -9223372036854775808, yes, 0x10, 1.5, 2001-09-09]"
    values = parse_yaml(text, "f.yaml").data
    assert values == [2**64 - 1, -(2**63), True, 16, 1.5, date(2001, 9, 9)]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "a: 060",
            "f.yaml:1:4: INVALID_VALUE: found 060, which YAML 1.1 reads as octal; expected decimal digits. Write 60",
        ),
        ("a: [1, 1:30]", "f.yaml:1:8: INVALID_VALUE: found 1:30, which YAML 1.1 reads in base 60; .* Write 90"),
        ("a: {b: 1_000}", "f.yaml:1:8: INVALID_VALUE: found 1_000, which has _ .* Write 1000"),
        ("a: 0b11", "f.yaml:1:4: INVALID_VALUE: found 0b11, which YAML 1.1 reads as binary"),
        ("a: 1e400", "f.yaml:1:4: SYNTAX: found '1e400', which is no number"),
        ("a: x\n1: x", "f.yaml:2:1: INVALID_VALUE: found the key 1, a number; expected a text. Write '1' in quotes"),
        ("true: 1", "f.yaml:1:1: INVALID_VALUE: found the key true, a truth value"),
        ("~: 1", "f.yaml:1:1: INVALID_VALUE: found the key ~, nothing"),
        ("a: b: c", "f.yaml:1:5: SYNTAX: found a second ': ' in one line.*Quote a text"),
        ("a: 1\nb: 'x\nc: 2\n", "f.yaml:2:4: SYNTAX: found a quote that is not closed; .* Close it"),
        ("a: {b: 1\n", "SYNTAX: found a list or mapping in brackets that is not closed"),
        ("a: 1\nb: x\x01", "f.yaml:2:5: SYNTAX: found an invisible control character"),
        ("a: *x", "f.yaml:1:4: SYNTAX: found an alias"),
        ("a: \tx\n\tb: 1", "f.yaml:2:1: SYNTAX: found a tab; .* Indent with blanks"),
        ("a: !foo x", "f.yaml:1:4: SYNTAX: found a tag"),
        ("a: 1\n---\nb: 1", "f.yaml:2:1: SYNTAX: found a second document"),
        ("a: 1\na: 2\n", "f.yaml:2:1: DUPLICATE_NAME: found 'a'"),
        ("a: [1\n", "f.yaml:1:4: SYNTAX"),
        ("- 1\n", r"f.yaml:1:1: INVALID_VALUE: found \[1\]; expected a mapping. Write {name: …}."),
    ],
)
def test_what_is_no_yaml_of_today_or_no_mapping_is_told_in_words_of_the_file(text, message):
    with pytest.raises(DefinitionError, match=message):
        validate(Outer, parse_yaml(text, "f.yaml"))


def test_numbers_are_read_as_in_yaml_1_2_and_written_so_that_texts_stay_texts():
    values = parse_yaml("[5e-1, 1.0e9, 1E+2, -.5e1, 0x1f, 07.5, '060', 5e, e5]", "f.yaml").data
    assert values == [0.5, 1e9, 100.0, -5.0, 31, 7.5, "060", "5e", "e5"]
    texts = {"yes": "5e-1", "060": ["1e5", "1:30", "12e4567"]}
    for written in (yaml.safe_dump(texts), msgspec.yaml.encode(texts).decode()):
        assert parse_yaml(written, "f.yaml").data == texts


class Numbers(Authored):
    number: float = 0.0
    count: int = 0
    flag: bool = False
    word: str = ""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("number: yes", "found true; expected a number. YAML reads yes, no, on and off as true and false"),
        ("number: '60'", "found '60'; expected a number. Write 60 without quotes"),
        ("number: .nan", "expected a finite number"),
        ("number: -.inf", "expected a finite number"),
        ("count: off", "found false; expected a whole number. YAML reads"),
        ("count: '3'", "found '3'; expected a whole number. Write 3 without quotes"),
        ("count: 08", "found '08'; expected a whole number. Write 8 without quotes"),
        ("count: 3.0", "found 3.0; expected a whole number. Write 3"),
        ("flag: 'no'", "found 'no'; expected true or false. Write no without quotes"),
        ("flag: 1", "found 1; expected true or false"),
        ("word: 5", "found 5; expected a text. Write '5' in quotes"),
        ("word: no", "found false; expected a text. YAML reads yes, no, on and off as true and false; quote a text"),
    ],
)
def test_a_number_a_truth_value_and_a_text_are_never_taken_for_one_another(text, message):
    with pytest.raises(DefinitionError, match=message):
        validate(Numbers, parse_yaml(text, "f.yaml"))


@pytest.mark.parametrize(
    ("value", "expected"),
    [(math.nan, "a finite number"), (math.inf, "a finite number"), (50, "at most 10.0 s"), (1, "")],
)
def test_a_number_of_a_skill_is_finite_and_in_its_range_and_so_is_its_default(value, expected):
    facts = {"type": "number", "unit": "s", "maximum": 10.0}
    assert find_mismatch(Parameter(**facts), value) == expected
    if expected:
        with pytest.raises(DefinitionError, match=f"expected {expected}"):
            validate(Parameter, parse_yaml(yaml.safe_dump({**facts, "default": value}), "f.yaml"))


def build_bomb(first, name):
    """Each line stands for nine times the one before; 340 bytes for a gigabyte in the end."""
    lines = [f"a{n}: &a{n} {name.format(', '.join([f'*a{n - 1}'] * 9))}" for n in range(1, 7)]
    return "\n".join([f"a0: &a0 {first}", *lines])


@pytest.mark.parametrize(
    "text",
    [
        build_bomb("[x, x, x, x, x, x, x, x, x]", "[{}]"),
        build_bomb("{x: 1}", "{{<<: [{}]}}"),
        "a: &a " + "x" * 100_000 + "\nb: [" + "*a, " * 1000 + "1]",
        "[" + "x, " * 100_000 + "x]",
    ],
)
def test_what_grows_beyond_memory_is_refused_before_it_is_built(text, monkeypatch):
    monkeypatch.setattr(Loader, "get_single_node", lambda _: pytest.fail("it was built"))
    with pytest.raises(DefinitionError, match=r"f\.yaml:\d+:\d+: SYNTAX: found more than 100000 values, or "):
        parse_yaml(text, "f.yaml")


def test_a_few_aliases_are_read():
    assert parse_yaml("a: &x [1, {b: 2}]\nc: [*x, *x]\n", "f.yaml").data["c"] == [[1, {"b": 2}]] * 2
