"""Handles of drawers, doors and buttons: seen on their paths alone, and stated as well as they are seen along these."""

import numpy as np
import pytest

from benchmarks.perception_parts.stage import Stage, World
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.protocol.world.environment import Mechanism, Pose
from phyagentos.protocol.world.mechanisms import compute_twist
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.runtime.perception.articulated import Path
from phyagentos.runtime.perception.association import associate
from phyagentos.runtime.perception.inventory import build_inventory
from tests.runtime.perception.conftest import look_from, make_cloud, spread

pytestmark = pytest.mark.sim
SCENE, BUTTONS = "tabletop/panel_and_stack", ("start", "stop")


def show_disc(item, middle_m):
    """The upper face of a cap with its middle there, as one camera above sees it."""
    face = spread(np.linspace(-0.025, 0.025, 15), np.linspace(-0.025, 0.025, 15), 0.006)
    return make_cloud(np.array(middle_m) + face[np.hypot(*face[:, :2].T) < 0.025], item.colors[0])


@pytest.mark.parametrize(("middle_m", "is_found"), [((0.5, -0.26, 0.074), True), ((0.5, 0.2, 0.074), False)])
def test_a_part_is_found_on_its_path_and_nowhere_else(middle_m, is_found):
    """What has its form and colour on the other side of the table is something else."""
    inventory = build_inventory(read_scene(Library.open().get_scene(SCENE)))
    cap = inventory.objects["stop_cap"]
    found = associate({"stop_cap": cap}, {}, show_disc(cap, middle_m), (look_from((0.5, 0.0, 1.4)),), inventory.map)

    assert ("stop_cap" in found) is is_found
    for match in found.values():
        np.testing.assert_allclose(match.fit.position_m, middle_m, atol=0.001)
        np.testing.assert_allclose(match.fit.rotation, np.eye(3), atol=1e-9)


def test_the_doubt_of_an_opening_is_that_along_its_path():
    """How far a cap may be off sideways says nothing of how far it is pressed."""
    sensors = read_sensors(find_shipped_root() / "protocol" / "sensors.yaml")
    errors, stated = [], []
    for seed in range(4):
        world = World(Library.open(), SCENE, seed)
        world.open_drawers(seed)
        stage = Stage(world, sensors, "nominal")
        belief = [stage.look() for _ in range(3)][-1]
        seen = [belief.entities[name] for name in BUTTONS if name in belief.entities]
        errors += [each.joint * each.mechanism.travel - world.find_opening(each.name) for each in seen]
        stated += [each.position_std_m for each in seen]

    assert np.mean(np.abs(errors) <= 2 * np.array(stated)) >= 0.95
    assert np.median(stated) < 1.6 * np.sqrt(np.mean(np.square(errors)))


@pytest.mark.parametrize("kind", ["slide", "hinge"])
def test_every_place_on_a_path_is_its_own_and_a_step_along_it_stays_on_it(kind):
    mechanism = Mechanism(kind, (0.0, 0.0, 1.0), 0.8, Pose((0.5, 0.1, 0.1), (0.8, 0.0, 0.0, 0.6)), (0.1, 0.0, 0.0))
    part = np.eye(4)
    part[:3, 3] = 0.3, 0.2, 0.05
    path = Path(mechanism, part)
    rotation, position_m = path.place(path.place(np.array([0.9, 0.4, 0.4]))[1])
    again, back_m = path.place(position_m)
    np.testing.assert_allclose(back_m, position_m, atol=1e-12)
    np.testing.assert_allclose(again, rotation, atol=1e-12)

    motion = compute_twist(mechanism, position_m)
    assert np.linalg.norm(motion[:3]) == pytest.approx(1.0)
    moved_m = position_m + 1e-5 * motion[:3]
    np.testing.assert_allclose(path.place(moved_m)[1], moved_m, atol=1e-9)
