"""Every misconfiguration of the corpus is refused before anything could move, with the right code; nothing sound is."""

from collections import Counter

import jsonschema
import msgspec
import numpy as np
import pytest

from phyagentos.codes import CODES
from phyagentos.protocol.capabilities.library import Library
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.process import LocalPlanner

from .corpus import SIDES, carry, make_control, read_cases, read_sound
from .recording import read_recorded, record

CASES = read_cases()


@pytest.fixture(scope="session")
def planner():
    local = MotionPlanner.open(Library.open().get_target("panda"))
    local.warm_up()
    return LocalPlanner(local)


def check(case, outcome):
    assert outcome.stage != "granted", f"{case.name} was granted"
    assert outcome.codes == set(case.expect), "\n".join(map(str, outcome.problems))
    assert not outcome.plans or outcome.problems


@pytest.mark.slow
@pytest.mark.parametrize(
    "case", [case for case in CASES if not case.plans], ids=lambda case: f"{case.side}-{case.name}"
)
def test_a_misconfiguration_is_refused_with_its_code(case, tmp_path):
    check(case, carry(case, tmp_path))


@pytest.mark.motion
@pytest.mark.parametrize("case", [case for case in CASES if case.plans], ids=lambda case: f"{case.side}-{case.name}")
def test_a_motion_that_cannot_exist_is_refused_with_its_code(case, tmp_path, planner):
    check(case, carry(case, tmp_path, planner))


@pytest.mark.slow
@pytest.mark.parametrize("case", read_sound(), ids=lambda case: case.name)
def test_what_is_unusual_and_fits_is_granted(case, tmp_path):
    outcome = carry(case, tmp_path)

    assert (outcome.stage, case.expect) == ("granted", ()), "\n".join(map(str, outcome.problems))


def test_the_corpus_is_large_and_drawn_from_every_side():
    count = Counter(case.side for case in CASES)

    assert len(CASES) >= 60
    assert all(count[side] >= 6 for side in SIDES), count


def test_every_expected_code_stands_in_the_table():
    assert {label.partition(" ")[0] for case in CASES for label in case.expect} <= set(CODES)


@pytest.mark.sim
@pytest.mark.parametrize("scene", Library.open().names_of_scenes())
def test_the_recordings_are_what_the_simulator_says(scene):
    kept, now = read_recorded(scene), record(scene, "panda", Library.open())

    assert kept.description == now.description
    assert kept.environment.entities.keys() == now.environment.entities.keys()
    for name, entity in now.environment.entities.items():
        assert entity.shapes == kept.environment.entities[name].shapes
        assert np.allclose(entity.pose.position_m, kept.environment.entities[name].pose.position_m, atol=1e-3)


@pytest.mark.slow
def test_a_manifest_takes_what_its_tools_take_and_nothing_else(tmp_path):
    _, manifest = carry(make_control("tidy_table"), tmp_path).plans[0]
    schemas = {tool.name: tool.arguments for tool in manifest.tools}
    home = list(read_recorded("tabletop/cubes_and_trays").environment.targets["panda"].q_rad)
    good = {"q_rad": [home] * 10, "qd_rad_s": [[0.0] * 7] * 10, "gripper_width_m": [0.04] * 10}

    assert set(schemas) == set(manifest.expose) == {"apply", "observe", "halt", "settle", "render"}
    jsonschema.validate(good, schemas["apply"], cls=jsonschema.Draft202012Validator)
    jsonschema.validate({"camera": "top"}, schemas["render"], cls=jsonschema.Draft202012Validator)
    for spoilt in (
        good | {"q_rad": [home] * 9},
        good | {"q_rad": [home[:6]] * 10},
        good | {"q_rad": [[9.0, *home[1:]]] * 10},
        good | {"gripper_width_m": [0.2] * 10},
        good | {"torque": 1},
    ):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(spoilt, schemas["apply"], cls=jsonschema.Draft202012Validator)
    assert "q_rad [10×7]" in str(manifest)
    assert len(msgspec.json.encode(manifest)) < 4000  # it stands in the journal, once a session
