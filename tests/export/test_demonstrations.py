"""What is read of recorded sessions as demonstrations, from a workspace that an earlier version recorded."""

import json

import numpy as np
import pytest

from phyagentos.errors import DefinitionError
from phyagentos.export.demonstrations import Choice, read_demonstrations
from phyagentos.protocol.sessions.evidence import TRAJECTORY
from tests.stored_workspace import unpack_stored

GOAL = "tidy_table-7"
VERIFIED = {f"{GOAL}.red.r1": "red_cube", f"{GOAL}.green": "green_cube", f"{GOAL}.blue": "blue_cube"}


def unpack(root):
    """The stored workspace; its manifests forget the pictures and models that were not stored."""
    for path in (unpack_stored(root) / "evidence").glob("*/manifest.json"):
        manifest = json.loads(path.read_bytes())
        manifest["files"] = {name: each for name, each in manifest["files"].items() if (path.parent / name).is_file()}
        path.write_text(json.dumps(manifest))
    return root / "tidy_table"


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    return unpack(tmp_path_factory.mktemp("stored"))


def read(stored, **choice):
    return read_demonstrations([stored], Choice(**choice))


def find_codes(stored, **choice):
    with pytest.raises(DefinitionError) as refused:
        read(stored, **choice)
    return {problem.label for problem in refused.value.problems}


def test_sessions_that_were_verified_are_read_and_the_one_that_lost_its_cube_is_not(stored):
    data = read(stored)
    assert {each.session for each in data.episodes} == set(VERIFIED)
    assert (data.names[0], data.names[-1], len(data.names), data.fps) == ("joint1", "gripper", 8, 50)
    assert all(each.verdict.verdict == "success" for each in data.episodes)


def test_sessions_that_missed_are_read_with_verdict_and_cause_where_they_are_wanted(stored):
    data = read(stored, failures=True)
    missed = {each.session: each.verdict for each in data.episodes if each.session not in VERIFIED}
    assert {id: each.verdict for id, each in missed.items()} == {f"{GOAL}.red": "replan"}
    assert missed[f"{GOAL}.red"].cause
    assert len(data.episodes) == 1 + len(VERIFIED)


@pytest.mark.parametrize(("fps", "every"), [(50, 1), (25, 2), (10, 5)])
def test_an_action_is_the_set_point_in_force_one_step_later(stored, fps, every):
    for each in read(stored, fps=fps).episodes:
        with np.load(each.bundle / TRAJECTORY) as recorded:
            commanded, measured = recorded["q_commanded"], recorded["q_measured"]
        n_steps = len(each.action)
        assert n_steps == (len(commanded) - 1) // every
        np.testing.assert_allclose(each.action[:, :-1], commanded[every::every][:n_steps], atol=1e-6)
        np.testing.assert_allclose(each.state[:, :-1], measured[::every][:n_steps], atol=1e-6)


def test_a_parameter_names_the_object_of_each_session(stored):
    data = read(stored, entities=("object",))
    for each in data.episodes:
        named = read(stored, entities=(VERIFIED[each.session],))
        (same,) = (other for other in named.episodes if other.session == each.session)
        np.testing.assert_array_equal(each.world, same.world)
    assert len({tuple(each.world) for each in data.episodes}) == 3


@pytest.mark.parametrize(
    ("choice", "code"),
    [
        ({"fps": 7}, "INVALID_VALUE"),
        ({"fps": 100}, "INVALID_VALUE"),
        ({"cameras": ("overhead",)}, "UNKNOWN_NAME (camera)"),
        ({"entities": ("moon",)}, "UNKNOWN_NAME (object)"),
        ({"skills": ("pour",)}, "NOT_EXECUTED"),
        ({"target": "ur5e"}, "NOT_EXECUTED"),
    ],
)
def test_what_cannot_be_had_is_refused_by_its_code(stored, choice, code):
    assert find_codes(stored, **choice) == {code}


def test_what_is_left_out_is_counted(stored):
    assert read(stored, skills=("pick_and_place",)).left_out == {}
    with pytest.raises(DefinitionError, match="3 with another skill"):
        read(stored, skills=("pour",))


def test_a_bundle_that_was_changed_is_refused_by_name(tmp_path):
    stored = unpack(tmp_path)
    path = stored / "evidence" / f"{GOAL}.blue" / TRAJECTORY
    path.write_bytes(path.read_bytes() + b"x")

    with pytest.raises(DefinitionError, match=f"{GOAL}.blue/{TRAJECTORY}"):
        read(stored)
