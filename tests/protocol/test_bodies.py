"""Bodies of records: what was put in comes out, by our own reader and by any YAML reader."""

import string

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from phyagentos.protocol.documents.body_codec import parse_body, prepare_body, render_body, render_yaml

TEXTS = (
    st.text(st.characters(exclude_categories=["Cs"]), max_size=40)
    | st.text(string.printable, max_size=40)
    | st.sampled_from(
        ["yes", "No", "null", "~", "1e5", "0x1F", "12:30:00", "2026-11-21", "- a", "a: b", "# c", "```", "="]
    )
)
SCALARS = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | TEXTS
VALUES = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXTS, inner, max_size=4), max_leaves=15
)
BODIES = st.dictionaries(TEXTS, VALUES, min_size=1, max_size=5)


@pytest.mark.slow
@given(BODIES)
def test_a_body_comes_back_as_it_was_by_every_reader_however_often_it_comes(body):
    (plain, markdown), (again, same) = prepare_body(body), prepare_body(body)

    assert plain == again == body
    assert plain is not again
    assert markdown == same == render_body(body)
    assert parse_body(markdown) == body
    assert parse_body(f"\n```yaml\n{render_yaml(body)}```\n") == body, "as earlier versions wrote it"
    record = markdown.removeprefix("\n```yaml\n").removesuffix("```\n")
    assert not any(line.startswith("```") for line in record.split("\n")), "no value closes the fence early"
    for text in (render_yaml(body), record):
        assert yaml.load(text, Loader=yaml.CSafeLoader) == body
        assert yaml.safe_load(text) == body


def test_numbers_that_are_equal_are_not_taken_for_each_other():
    numbers = [0.0, -0.0, 0, 1.0, 1, True, 2.5, 2.5]

    assert [render_yaml({"a": {"b": number}}) for number in numbers] == [
        f"a:\n  b: {text}\n" for text in ("0.0", "-0.0", "0", "1.0", "1", "true", "2.5", "2.5")
    ]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a: {b: 1, c: [x, y]}\n", {"a": {"b": 1, "c": ["x", "y"]}}),
        ("# by hand\na: yes\n", {"a": True}),
        ("a: |\n  two\n  lines\n", {"a": "two\nlines\n"}),
        ("a:\n- 1\n- b: 2\n", {"a": [1, {"b": 2}]}),
        ("a: 0x10\nb: '1'\n", {"a": 16, "b": "1"}),
        ("a: &x 1\nb: *x\n", {"a": 1, "b": 1}),
    ],
)
def test_yaml_that_somebody_else_wrote_is_read_by_libyaml(text, value):
    assert parse_body(f"\n```yaml\n{text}```\n") == value


def test_a_record_without_a_fence_has_no_body():
    assert parse_body("") is None
    assert parse_body("only prose\n") is None


def test_a_contract_reads_like_a_contract():
    body = {
        "objective": "Put the red cube into its tray",
        "accept": ["inside(red_cube, red_tray)"],
        "pose": [0.1, 1e-07, 3],
        "limits": {"timeout_s": 60.0},
        "criteria": [{"text": "a", "truth": "false"}, {"text": "b"}],
    }

    assert render_yaml(body) == (
        "objective: Put the red cube into its tray\n"
        'accept: ["inside(red_cube, red_tray)"]\n'
        "pose: [0.1, 1.0e-07, 3]\n"
        "limits:\n"
        "  timeout_s: 60.0\n"
        "criteria:\n"
        "  - text: a\n"
        '    truth: "false"\n'
        "  - text: b\n"
    )
