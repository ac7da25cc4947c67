"""A strategy is one struct: its keys on disk are those of earlier journals, and two of them are joined by field."""

import msgspec
import pytest

from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy


@pytest.mark.parametrize(
    "keyed", [{}, {"speed": 0.5}, {"avoid_grasps": ["yaw+000"], "speed": 0.25}, {"avoid_sites": ["site0", "site1"]}]
)
def test_the_keys_on_disk_are_the_names_of_what_is_done_differently(keyed):
    strategy = msgspec.convert(keyed, Strategy)
    assert msgspec.json.decode(msgspec.json.encode(strategy)) == keyed
    assert strategy.changed == keyed.keys()
    assert bool(strategy) == bool(keyed)


def test_two_strategies_avoid_what_either_does_and_the_own_speed_wins():
    own = Strategy(avoid_grasps=("a",), speed=0.5)
    other = Strategy(avoid_grasps=("b", "a"), avoid_sites=("s",), speed=0.25)
    assert own.join(other) == Strategy(avoid_grasps=("a", "b"), avoid_sites=("s",), speed=0.5)
    assert DEFAULT_STRATEGY.join(other) == other


def test_people_read_it_as_words():
    assert str(Strategy(avoid_grasps=("a", "b"), speed=0.5)) == "with another grasp (not a or b) at half speed"
    assert str(DEFAULT_STRATEGY) == ""
