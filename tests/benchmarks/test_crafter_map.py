"""What an agent in Crafter remembers, without the game."""

from pathlib import Path
from types import SimpleNamespace

import pytest

KIT = Path(__file__).resolve().parents[2] / "kits" / "crafter"


class Zombie(SimpleNamespace):
    pass


class Cow(SimpleNamespace):
    pass


@pytest.fixture
def env_of(monkeypatch):
    """Grass without an end, with creatures by cell."""
    monkeypatch.syspath_prepend(str(KIT))

    class Grass(dict):
        def __missing__(self, cell):
            return "grass", None

    def make(creatures):
        world = Grass({cell: ("grass", kind(pos=cell)) for cell, kind in creatures.items()})
        return SimpleNamespace(_world=world, _player=SimpleNamespace(pos=(0, 0), facing=(0, 1)))

    return make


def test_a_foe_that_went_out_of_view_is_still_kept_away_from_for_a_while_and_a_cow_is_remembered(env_of):
    from crafter_body.local_map import KEPT, LocalMap

    env = env_of({(4, 0): Zombie, (4, 1): Cow})
    seen = LocalMap(env)
    far = seen.measure_routes([], {"zombie"})[0][2, 0]
    env._player.pos = (-1, 0)  # one cell farther than it sees
    for _ in range(KEPT):
        seen.look()
    assert (4, 0) not in seen.creatures
    assert seen.measure_routes([], {"zombie"})[0][2, 0] > far > 3
    seen.look()
    assert seen.measure_routes([], {"zombie"})[0][2, 0] == 3
    assert [*seen.last_seen] == [(4, 1)]
    env._player.pos, env._world[4, 1] = (0, 0), ("grass", None)
    seen.look()
    assert (4, 1) not in seen.last_seen
