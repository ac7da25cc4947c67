"""What the real world process says of each shipped scene, kept as JSON, so that most cases need no simulator.

    python tests/preflight_corpus/recording.py

A test compares the files with the simulator. Upstream: `MujocoDriver`. Downstream: `corpus`.
"""

import tempfile
from pathlib import Path
from types import SimpleNamespace

import msgspec

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.sessions.session import Scene
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.targets import wire

FOLDER = Path(__file__).parent / "recorded"
SEED = 0
EPISODE = "recorded"


class Recorded(msgspec.Struct, frozen=True, kw_only=True):
    """One scene as it begins.

    Attributes:
        description: Of the target, with the scene loaded.
        environment: The world at rest.
    """

    description: wire.Description
    environment: Environment


def read_recorded(scene: str) -> Recorded:
    """The recording of a scene."""
    return msgspec.json.decode(get_file(scene).read_bytes(), type=Recorded)


def get_file(scene: str) -> Path:
    """Where the recording of a scene is."""
    return FOLDER / f"{scene.replace('/', '__')}.json"


def record(scene: str, target: str, library: Library, seed: int = SEED) -> Recorded:
    """Ask a simulated world, as the world process would hold it."""
    from phyagentos.runtime.drivers.mujoco.world import MujocoDriver, SimulatedWorld
    from phyagentos.runtime.models.robot import read_profile
    from phyagentos.runtime.perception.world_model import WORLD, GroundTruthWorldModel
    from phyagentos.runtime.targets.receive_log import ReceiveLog
    from phyagentos.runtime.targets.served_target import ServedTarget

    profile, folder = read_profile(library.get_target(target))
    with tempfile.TemporaryDirectory() as logs:
        log = ReceiveLog(Path(logs) / "receive.jsonl")
        driver = MujocoDriver(SimulatedWorld(library), profile, folder)
        world = ServedTarget(driver, log)
        world.handle(wire.LoadScene(scene=scene, seed=seed, episode=EPISODE))
        description, observation = world.handle(wire.Describe()), world.handle(wire.Observe(truth=True))
        world.close()
    assert isinstance(description, wire.Description), description
    assert isinstance(observation, wire.Observation), observation
    truth = GroundTruthWorldModel(target, SimpleNamespace(latest=None, observe=lambda: observation))
    truth.enter(Scene(name=scene, seed=seed, episode=EPISODE))
    return Recorded(description=description, environment=truth.observe(WORLD))


def main() -> None:
    """Write every recording again."""
    library = Library.open()
    for scene in library.names_of_scenes():
        data = msgspec.json.encode(record(scene, "panda", library))
        get_file(scene).write_bytes(msgspec.json.format(data, indent=1))


if __name__ == "__main__":
    main()
