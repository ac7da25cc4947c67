"""Gymnasium environments as targets, each in the environment of `--gymnasium-python`: small ones, and Meta-World."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.runtime.drivers.gymnasium import open_gymnasium
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.testing import DRIVER_CHECKS, DriverClient, DriverSubject
from tests.conformance.test_target_drivers import write_environment

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "projects"
EXAMPLE, META_WORLD = EXAMPLES / "06_gymnasium", EXAMPLES / "08_meta_world"
SMALL = {"MountainCar-v0": (0.0, 2.0), "MountainCarContinuous-v0": (-1.0, 1.0), "CartPole-v1": (0.0, 1.0)}

pytestmark = pytest.mark.extras


@pytest.fixture
def example(tmp_path, pytestconfig):
    """The example with the interpreter that has its environment."""
    return copy_with_python(EXAMPLE, tmp_path / "example", pytestconfig.option.gymnasium_python)


def copy_with_python(example, folder, python):
    """A copy whose robot has this interpreter."""
    shutil.copytree(example, folder)
    path = folder / "robots" / "sawyer" / "gymnasium.yaml"
    settings = yaml.safe_load(path.read_text()) | {"python": str(Path(python).absolute())}
    settings.pop("environment", None)
    path.write_text(yaml.safe_dump(settings))
    return folder


@pytest.fixture
def opened():
    """Opens targets of a folder under authority, and closes them."""
    targets = []

    def open_client(folder):
        driver = open_gymnasium(read_target(folder / "target.yaml"), folder)
        targets.append(ServedTarget(driver, ReceiveLog(None)))
        return DriverClient(targets[-1], DriverSubject(open=lambda: driver, scene="any"))

    yield open_client
    for target in targets:
        target.close()


@pytest.mark.parametrize("check", DRIVER_CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("name", ["MountainCar-v0", "sawyer"])
def test_an_environment_does_what_the_port_promises(name, check, tmp_path, example, pytestconfig):
    if name == "sawyer":
        folder = example / "robots" / "sawyer"
    else:
        folder = write_environment(tmp_path, pytestconfig.option.gymnasium_python, name, *SMALL[name])
    subject = DriverSubject(open=lambda: open_gymnasium(read_target(folder / "target.yaml"), folder), scene="drawer")
    check(subject)
    subject.close()


@pytest.mark.parametrize("name", SMALL)
def test_spaces_of_every_kind_take_actions_and_an_episode_that_is_over_moves_no_more(
    name, tmp_path, opened, pytestconfig
):
    client = opened(write_environment(tmp_path, pytestconfig.option.gymnasium_python, name, *SMALL[name])).begin()
    replies = [client.send(client.make()) for _ in range(1001)]

    stopped = [index for index, reply in enumerate(replies) if isinstance(reply, wire.Step) and reply.stopped]
    assert [replies[index].stopped for index in stopped] == ["TARGET_LIMIT"]
    assert {reply.code for reply in replies[stopped[0] + 1 :]} == {"TARGET_LIMIT"}
    assert isinstance(client.ask(wire.End("conformance", 1)), wire.Ended)
    assert isinstance(client.load("another"), wire.Loaded)
    assert client.ask(wire.Begin("next", 1)) == wire.Ack()
    assert client.send(client.make(session="next", sequence=1)).stopped == ""


def test_a_seed_is_a_world(example, opened):
    client = opened(example / "robots" / "sawyer")
    worlds = []
    for episode, seed in (("a", 3), ("b", 4), ("c", 3)):
        client.load(episode, seed)
        worlds.append(client.ask(wire.Observe(truth=True)))

    assert worlds[0] == worlds[2]
    assert worlds[0].entities[0].pose != worlds[1].entities[0].pose


def test_the_name_of_a_scene_is_a_task_and_what_it_observes_is_published(tmp_path, opened, pytestconfig):
    folder = copy_with_python(META_WORLD, tmp_path / "example", pytestconfig.option.gymnasium_python)
    client = opened(folder / "robots" / "sawyer")
    goals = {}
    for task in ("push-v3", "button-press-v3"):
        client.ask(wire.LoadScene(task, 3, task))
        seen = client.ask(wire.Observe(truth=True))
        observed, regions = seen.signals["observation"], {each.name: each for each in seen.regions}
        assert len(observed) == 39
        assert regions["goal"].pose.position_m == observed[36:39]
        assert regions["goal_of_hand"].pose.position_m[2] == pytest.approx(observed[38] + 0.045)
        assert {each.name: each.pose.position_m for each in seen.entities}["thing"] == observed[4:7]
        goals[task] = observed[36:39]
    assert goals["push-v3"] != goals["button-press-v3"]
    assert client.ask(wire.Observe()).signals == {}, "not where no truth is asked for"


def test_an_observed_joint_is_as_open_as_between_its_two_ends(tmp_path, opened, pytestconfig):
    folder = write_environment(tmp_path, pytestconfig.option.gymnasium_python, "MountainCarContinuous-v0", -1.0, 1.0)
    car = {"kind": "car", "joint": 0, "closed": -1.2, "opened": 0.6}
    path = folder / "gymnasium.yaml"
    path.write_text(path.read_text() + yaml.safe_dump({"entities": {"car": car}, "signals": {"seen": [0, 2]}}))
    client = opened(folder)
    client.load("a", 3)
    seen = client.ask(wire.Observe(truth=True))
    assert seen.entities[0].joint == pytest.approx((seen.signals["seen"][0] + 1.2) / 1.8)


@pytest.mark.parametrize("change", [{"id": "NoSuch-v0"}, {"no_such_key": 1}])
def test_settings_that_no_environment_takes_are_explained(example, change):
    folder = example / "robots" / "sawyer"
    path = folder / "gymnasium.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | change))

    with pytest.raises(DefinitionError, match=r"NO_DRIVER: found (NameNotFound|TypeError): .*[nN]o_?[sS]uch"):
        open_gymnasium(read_target(folder / "target.yaml"), folder)


@pytest.mark.journey
def test_meta_world_is_judged_by_evidence_and_its_own_success_stays_with_it(example, tmp_path):
    command = [sys.executable, "-m", "phyagentos", "run", "goal_graphs/close_drawer.yaml", "--seed", "3"]
    command += ["--workspace", str(tmp_path / "w"), "--no-pictures", "--json"]
    environment = os.environ | {"PYTHONPATH": str(EXAMPLE.parents[1])}
    done = subprocess.run(
        command, cwd=example, env=environment, capture_output=True, text=True, timeout=300, check=False
    )

    assert done.returncode == 0, done.stderr
    evidence = tmp_path / "w" / "evidence" / "close_drawer-3.push"
    execution = json.loads((evidence / "execution.json").read_text())
    assert execution["driver"] == "gymnasium/Meta-World/MT1"
    before, after = (
        json.loads((evidence / f"environment_{when}.json").read_text())["entities"]["handle"]["pose"]["position_m"]
        for when in ("before", "after")
    )
    assert after[1] - before[1] > 0.1
    (outcome,) = map(json.loads, (tmp_path / "w" / ".world" / "outcomes.jsonl").read_text().splitlines())
    assert outcome["success"], "the environment agrees with the verdict"
    assert outcome["session"] == evidence.name
    for file in evidence.iterdir():
        assert b'"success"' not in file.read_bytes(), f"{file.name} tells what the environment says of success"
