"""`paos describe` tells what the code declares."""

import json

import pytest

from phyagentos.cli.outcome import ExitCode


@pytest.mark.parametrize(
    ("kind", "name", "row"),
    [
        ("leaf", "wait", ("input", "seconds", "number", "required", "How long, simulated [s].")),
        ("skill", "pick", ("guarantees", "holding(target, ${object})", "", "", "")),
        ("predicate", "near", ("argument", "distance_m", "number", "0.1", "")),
        ("fault", "slip", ("field", "duration_s", "number", "`0.5`", "above 0.0")),
        ("setting", "perception", ("field", "version", "`1`", "`1`", "Of this format")),
    ],
)
def test_each_kind_is_described_by_its_declaration(paos, kind, name, row):
    (found,) = json.loads(paos("describe", kind, name, "--json").out)
    rows = [
        tuple(each.get(key, "") for key in ("part", "name", "takes", "default", "meaning")) for each in found["rows"]
    ]
    assert row in rows
    text = paos("describe", kind, name).out
    assert all(word.replace("`", "") in text for word in (name, *row))
    assert "`" not in text + paos("describe", kind).out, "a terminal shows no Markdown"
    assert name in paos("describe", kind).out


def test_a_setting_is_found_by_its_name_alone(paos):
    assert paos("describe", "setting", "sensing").out.startswith("perception  setting\nThe whole of perception.yaml\n")


def test_slips_name_the_nearest(paos):
    assert "Did you mean 'wait'?" in paos("describe", "leaf", "wiat").err
    result = paos("describe", "leafs")
    assert (result.code, "Did you mean 'leaf'?" in result.err) == (ExitCode.INVALID_INPUT, True)


def test_a_name_alone_is_found_in_every_kind_and_stands_first(paos):
    assert paos("describe", "pick_and_place").out.startswith("pick_and_place  skill\nTakes an object")
    assert "Did you mean 'slip'?" in paos("describe", "slipp").err


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("tidy_table", "paos compile"),
        ("tabletop/drawer", "paos scene render"),
        ("panda", "paos robot show"),
        ("turn_once", "paos tree show"),
    ],
)
def test_what_another_command_shows_is_refused_with_that_command(paos, name, command):
    assert f"{command} {name} shows it." in paos("describe", name).err


def test_a_robot_is_shown_in_columns_without_markup(paos):
    shown = paos("robot", "show", "panda").out
    assert shown.startswith("robot  ")
    assert not {"|", "---", "\x1b"} & set(shown.replace("\n", " ").split(" "))
