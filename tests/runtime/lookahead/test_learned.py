"""The learned forecaster: repeatable from its file, unsure where it has seen little, and closed to hostile files."""

import json
import pickle

import pytest
from learned_forecaster.features import describe_case
from learned_forecaster.forecaster import open_learned
from learned_forecaster.model import fit_model, read_model, validate_model

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.evidence import encode_json
from phyagentos.protocol.sessions.lookahead import LookaheadRequest
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Entity, Environment, Pose, Shape, ShapeKind, TargetState
from phyagentos.runtime.lookahead.forecaster import Case, ForecasterSite
from phyagentos.testing import make_contract
from tests.learned_kit import draw_examples

EXAMPLES = draw_examples(200)
NEAR, FAR = ({"skill=carry": 1.0, "thing_to_place_m": way_m, "noise": 0.0} for way_m in (0.1, 0.9))


@pytest.fixture(scope="module")
def model():
    return fit_model(EXAMPLES)


@pytest.fixture
def path(tmp_path, model):
    path = tmp_path / "model.json"
    path.write_bytes(encode_json(model))
    return path


def make_case(tree="carry"):
    cube = Entity(name="cube", kind="cube", pose=Pose((0.4, 0.0, 0.02)), shapes=(Shape(ShapeKind.BOX, (0.02,) * 3),))
    coin = Entity(name="coin", kind="coin", pose=Pose((0.4, 0.0, 0.05)))
    tray = Entity(name="tray", kind="tray", pose=Pose((0.4, 0.3, 0.0)), movable=False)
    arm = TargetState(q_rad=(0.0,), qd_rad_s=(0.0,), gripper_width_m=0.08, tcp=Pose((0.4, 0.0, 0.52)))
    world = Environment(
        time_s=0.0,
        scene="table",
        episode="e",
        revision=1,
        sensing="truth",
        entities={each.name: each for each in (cube, coin, tray)},
        targets={"panda": arm},
    )
    session = make_contract(skill="carry", parameters={"object": "cube", "destination": "tray"})
    return Case(session=session, request=LookaheadRequest(), tree=tree, environment=world)


def test_a_session_and_its_estimate_become_numbers_by_name():
    case = make_case()
    found = describe_case(case.session, case.environment)

    assert {name for name in found if "=" in name} == {
        "skill=carry", "target=panda", "scene=s", "kind=cube", "place=tray"
    }  # fmt: skip
    numbers = {"load": 1, "crowd": 1, "place_crowd": 0, "speed": 1, "thing_to_place_m": 0.3007, "hand_to_thing_m": 0.5}
    assert {name: found[name] for name in numbers} == pytest.approx(numbers, abs=1e-4)


def test_what_makes_sessions_fail_is_learned_and_what_does_not_is_not(model):
    near, far = (model.foresee(features, "carry") for features in (NEAR, FAR))
    weights = {each.name: each.weight for each in model.features}

    assert near.share > 0.8 > 0.5 > far.share
    assert far.causes == {"GRASP_LOST": pytest.approx(far.samples * (1.0 - far.share))}
    assert abs(weights["noise"]) < 0.3 * abs(weights["thing_to_place_m"])


def test_it_foresees_held_out_sessions_better_than_the_base_rate_and_noise_no_better():
    record = validate_model(EXAMPLES, seed=0)
    blind = validate_model([each._replace(features={"skill=carry": 1.0}) for each in EXAMPLES], seed=0)

    assert record.brier < 0.85 * record.base_brier
    assert blind.brier == pytest.approx(blind.base_brier, rel=0.03)


def test_the_same_sessions_give_the_same_file_and_the_file_the_same_forecasts(model, path):
    assert encode_json(fit_model(draw_examples(200))) == path.read_bytes()
    again, _ = read_model(path)
    assert again.foresee(FAR, "carry") == model.foresee(FAR, "carry")


def test_where_it_has_seen_nothing_alike_it_is_less_sure(model):
    known, strange = (model.foresee(NEAR | more, "carry") for more in ({}, {"kind=anvil": 1.0}))
    few = fit_model(EXAMPLES[:20]).foresee(NEAR, "carry")

    assert known.samples > 2 * strange.samples
    assert known.samples > 2 * few.samples
    assert abs(strange.share - 0.5) < abs(known.share - 0.5)


def test_policies_are_foreseen_too_and_the_version_is_the_hash_of_the_file(path):
    workspace = Workspace.create(path.parent / "workspace", Library(()))
    forecaster = open_learned(ForecasterSite(workspace, "panda", {"model": "../model.json"}))
    forecast = forecaster.forecast(make_case(tree=""))

    assert forecast.forecaster == forecaster.name
    assert forecaster.name.startswith("learned/1(")
    path.write_bytes(encode_json(fit_model(EXAMPLES[:100])))
    assert open_learned(ForecasterSite(workspace, "panda", {"model": "../model.json"})).name != forecaster.name


INPUT = {"name": "a", "mean": 0.0, "scale": 1.0, "weight": 0.0}


class Bomb:
    def __reduce__(self):
        return (pytest.fail, ("a model was unpickled",))


def spoil(data, **changes):
    return json.dumps(json.loads(data) | changes).encode()


@pytest.mark.parametrize(
    ("make", "found"),
    [
        (lambda _: pickle.dumps(Bomb()), "malformed|utf-8|invalid"),
        (lambda _: b"", "truncated"),
        (lambda data: data[: len(data) // 2], "truncated"),
        (lambda _: b"[" * 100_000, "recursion|malformed|depth|Expected"),
        (lambda data: spoil(data, model="phyagentos learned forecaster/2"), "Invalid enum value"),
        (lambda data: spoil(data, __reduce__="os.system"), "unknown field"),
        (lambda data: spoil(data, intercept=float("nan")), "malformed"),
        (lambda data: data.replace(b'"intercept": ', b'"intercept": 1e999', 1), "."),
        (lambda data: spoil(data, intercept="0"), "Expected `float`"),
        (lambda data: spoil(data, covariance=[[1.0]]), "a covariance that is not 4 x 4"),
        (lambda data: spoil(data, covariance=[[-1.0] * 4] * 4), "a covariance that is none"),
        (lambda data: spoil(data, covariance=[[1.0, 9, 9, 9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]), "is none"),
        (lambda data: spoil(data, features=[INPUT] * 501), "length <= 500"),
        (lambda data: spoil(data, features=[INPUT | {"scale": 0.0}]), "> 0"),
        (lambda data: spoil(data, causes={"carry": {"GRASP_LOST": 0}}), ">= 1"),
    ],
)
def test_a_file_that_is_no_whole_model_is_refused_and_nothing_in_it_is_run(path, make, found):
    path.write_bytes(make(path.read_bytes()))

    with pytest.raises(DefinitionError, match=rf"model.json: INVALID_VALUE: found .*({found})"):
        read_model(path)


def test_a_file_that_is_not_there_and_a_missing_option_say_what_makes_one(tmp_path):
    with pytest.raises(DefinitionError, match=r"No such file.*python -m learned_forecaster"):
        read_model(tmp_path / "model.json")
    workspace = Workspace.create(tmp_path / "workspace", Library(()))
    with pytest.raises(
        DefinitionError, match=r"forecasting.options.learned: MISSING_VALUE.*python -m learned_forecaster"
    ):
        open_learned(ForecasterSite(workspace, "panda"))
