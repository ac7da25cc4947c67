"""Every forecaster that ships or is installed: named with a version, a distribution over outcomes, repeatable."""

import msgspec
import pytest
from learned_forecaster.model import fit_model

from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.sessions.evidence import encode_json
from phyagentos.protocol.sessions.forecasters import FORECASTERS
from phyagentos.protocol.sessions.lookahead import DEFAULT_FORECASTER, LookaheadRequest, LookaheadResult
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
from phyagentos.runtime.lookahead.forecaster import Case, ForecasterSite, open_forecaster
from phyagentos.runtime.lookahead.service import ForecastService
from phyagentos.runtime.perception.world_model import WORLD, GroundTruthWorldModel
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import Loopback
from phyagentos.testing import make_contract
from tests.learned_kit import announce, draw_examples

pytestmark = [pytest.mark.sim, pytest.mark.motion]

NAMES = sorted({DEFAULT_FORECASTER, "learned", *FORECASTERS.names()})
OPTIONS = {"learned": {"model": "model.json"}}
SCENE = Scene(name="tabletop/waiter", seed=7, episode="e")
REQUEST = LookaheadRequest(samples=2, threshold=0.0, seed=5)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("forecasters")
    workspace = Workspace.create(folder / "workspace", Library.open())
    (workspace.root / "model.json").write_bytes(encode_json(fit_model(draw_examples(40))))
    announce(folder / "site")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder / "site")
        yield ForecasterSite(workspace, "panda")


@pytest.fixture(scope="module")
def case(site):
    path = site.workspace.library().get_target("panda")
    driver = MujocoDriver(SimulatedWorld(site.workspace.library()), read_target(path), path.parent)
    limits = read_safety(site.workspace.safety).targets["panda"]
    handle = TargetSessionHandle(Loopback(ServedTarget(driver, ReceiveLog(None))), limits, sees_truth=True)
    handle.load(SCENE)
    truth = GroundTruthWorldModel("panda", handle)
    truth.enter(SCENE)
    session = make_contract(
        parameters={"object": "coaster", "destination": "tray"}, accept=("inside(coaster, tray)",), scene=SCENE
    )
    return Case(session=session, request=REQUEST, tree="pick_and_place", environment=truth.observe(WORLD))


@pytest.fixture(scope="module", params=NAMES)
def answered(request, site, case):
    given = ForecasterSite(site.workspace, site.target, OPTIONS.get(request.param, {}))
    forecaster = open_forecaster(request.param, given)
    service = ForecastService({request.param: forecaster}.__getitem__, SystemClock())
    asked = msgspec.structs.replace(case, request=msgspec.structs.replace(case.request, forecasters=(request.param,)))
    before = msgspec.msgpack.encode(asked)
    return request.param, [service.forecast(asked) for _ in range(2)], before == msgspec.msgpack.encode(asked)


def test_a_forecaster_is_named_with_a_version(answered):
    name, (result, _), _ = answered

    assert result.forecaster.split("/")[0] == name
    assert result.forecaster.split("/")[1][0].isdigit()


def test_a_forecast_is_a_distribution_over_outcomes_by_code_with_an_interval(answered):
    _, (result, _), _ = answered
    low, high = result.interval

    assert 0.0 <= low <= result.share <= high <= 1.0
    assert result.succeeded + sum(result.causes.values()) == pytest.approx(result.samples)
    assert all(cause == cause.upper() for cause in result.causes)
    assert result.cost_ms > 0.0


def test_the_same_case_has_the_same_forecast_and_stays_as_it_is(answered):
    _, (first, again), is_unchanged = answered

    assert is_unchanged
    assert msgspec.structs.replace(first, cost_ms=0.0) == msgspec.structs.replace(again, cost_ms=0.0)


def test_a_forecast_is_the_same_after_a_journey_through_a_file(answered):
    _, (result, _), _ = answered

    assert msgspec.json.decode(msgspec.json.encode(result), type=LookaheadResult) == result
