"""Luanti as a target, where the game is installed: what is seen, tools, the game's book, sessions that are judged."""

import math
import shutil
from pathlib import Path

import pytest
import yaml

from benchmarks.luanti import GROUPS, LIBRARY, try_tasks
from phyagentos.clock import SystemClock

KITS = Path(__file__).resolve().parents[2] / "kits"
SERVER = Path("/usr/lib/minetest/minetestserver")
INSTALL = "paos bench setup luanti says what to install"

pytestmark = [pytest.mark.extras, pytest.mark.skipif(not SERVER.exists(), reason=INSTALL)]


@pytest.fixture(scope="module")
def worlds(tmp_path_factory):
    return tmp_path_factory.mktemp("worlds")


@pytest.fixture
def kit(monkeypatch, worlds):
    for name in ("luanti", "target_server"):
        monkeypatch.syspath_prepend(str(KITS / name))
    monkeypatch.setenv("LUANTI_WORLDS", str(worlds))


@pytest.fixture
def body(kit):
    from luanti_body.body import LuantiBody

    body = LuantiBody()
    body.load("land", 1, b"")
    yield body
    body.close()


def use(body, tool, **arguments):
    """How many steps a tool takes; raises as it does."""
    return sum(1 for action in body.toolbox[tool].run(**arguments) if body.act(action) is None)


def test_nothing_is_seen_behind_the_ground_or_farther_than_sixteen_nodes(body):
    terrain, at = body._agent.terrain, body._agent.at
    eye = (at[0], at[1] + 1, at[2])
    assert max(math.dist(cell, eye) for cell in terrain.cells) < 18.0, "sixteen, and the rounding to whole nodes"
    ground = [cell for name, cells in terrain.places.items() if terrain.kinds[name].is_solid for cell in cells]
    sides = [(0, 1, 0), (0, -1, 0), (1, 0, 0), (-1, 0, 0), (0, 0, 1), (0, 0, -1)]

    def is_bare(cell):
        near = [tuple(a + b for a, b in zip(cell, side, strict=True)) for side in sides]
        return any(each not in terrain.cells or terrain.is_open(each) for each in near)

    assert ground
    assert all(map(is_bare, ground))
    assert not any("_with_" in name and "stone" in name for name in terrain.places), "ore under grass is not known"


def test_tools_take_time_and_do_what_the_game_allows(body):
    from target_server.tool_body import ToolFailed

    with pytest.raises(ToolFailed, match="needs another tool"):
        use(body, "collect", what="default_cobble", amount=1)
    assert use(body, "collect", what="group_tree", amount=4) >= 35, "3.5 s of digging by hand for a trunk"
    with pytest.raises(ToolFailed, match="lacks"):
        use(body, "craft", what="default_pick_wood", amount=1)
    use(body, "craft", what="group_wood", amount=16)
    use(body, "craft", what="default_stick", amount=8)
    use(body, "craft", what="default_pick_wood", amount=1)
    use(body, "equip", what="default_pick_wood")
    use(body, "collect", what="default_cobble", amount=12)
    use(body, "craft", what="default_furnace", amount=1)
    height = body.read().vitals["height"]
    use(body, "descend_to", height=int(height) - 3)
    use(body, "dig_tunnel", direction="east", length=4)
    assert body.read().vitals["height"] == height - 3
    use(body, "place", what="default_furnace")
    assert body.read().nearby == ("default_furnace",)
    with pytest.raises(ToolFailed, match="nothing to eat"):
        use(body, "eat", what="default_stick")
    with pytest.raises(ToolFailed, match="nothing is in reach"):
        use(body, "attack")
    with pytest.raises(ToolFailed, match="carries nothing that becomes"):
        use(body, "smelt", what="default_gold_ingot", amount=1)
    assert body.read().inventory["group_wood"] == 16 - 2 - 3
    assert body.read().vitals["health"] == 20.0


def test_the_book_of_the_library_is_that_of_the_game(kit, tmp_path):
    from luanti_body.write_books import main

    shutil.copytree(LIBRARY / "skills", tmp_path / "skills")
    main(tmp_path / "skills", [item for items in GROUPS.values() for item in items])
    for skill in ("gather", "craft", "smelt"):
        written = yaml.safe_load((tmp_path / "skills" / skill / "recipes.yaml").read_text())
        assert written == yaml.safe_load((LIBRARY / "skills" / skill / "recipes.yaml").read_text())


def test_a_planned_goal_is_met_by_what_the_server_says_is_carried(kit):
    (line,) = try_tasks([("Wood", "default_pick_wood", 1)], SystemClock())
    assert (line["is_met"], line["sessions"]) == (True, 4)
