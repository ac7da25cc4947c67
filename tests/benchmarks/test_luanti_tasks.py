"""Tasks in Luanti without the game: plans from its book, what a player knows of its terrain, and the figures."""

import json
from pathlib import Path

import pytest
import yaml

from benchmarks.luanti import GROUPS, LIBRARY, read_outcomes, sum_up, write_goal
from phyagentos.protocol.capabilities.library import Library

KITS = Path(__file__).resolve().parents[2] / "kits"
STONE = {"is_solid": True, "is_liquid": False, "hurts": False, "falls": False}
NODES = {
    "air": STONE | {"is_solid": False},
    "stone": STONE,
    "ore": STONE,
    "lava": STONE | {"is_solid": False, "is_liquid": True, "hurts": True},
}


@pytest.fixture
def terrain_of(monkeypatch):
    """A terrain seen as far as ten nodes: stone up to y = 0 and air above it, or as given."""
    for kit in ("luanti", "target_server"):
        monkeypatch.syspath_prepend(str(KITS / kit))
    from luanti_body.terrain import Terrain, read_kinds

    def make(changes, times, blocks=0):
        terrain, names = Terrain(read_kinds(NODES), blocks=blocks), [*NODES]
        span = range(-10, 11)
        cells = {(x, y, z): "stone" if y <= 0 else "air" for x in span for y in span for z in span} | changes
        terrain.note(names, [n for cell, name in cells.items() for n in (*cell, names.index(name))], times)
        return terrain

    return make


def list_ring(size, heights):
    span = range(-size, size + 1)
    return [(x, y, z) for x in span for y in heights for z in span if max(abs(x), abs(z)) == size]


def list_cells(route):
    return [move.to for move in route]


def test_it_walks_where_it_can_and_digs_where_it_has_the_tool(terrain_of):
    wall = dict.fromkeys(list_ring(2, range(1, 5)), "stone") | dict.fromkeys(list_ring(1, [5]), "stone")
    wall[0, 5, 0] = "stone"
    bare, armed = terrain_of(wall, {}), terrain_of(wall, {"stone": 1.0})
    assert list_cells(bare.find_route((0, 1, 0), {(1, 1, 0)}, to_reach=False)) == [(1, 1, 0)]
    assert bare.find_route((0, 1, 0), {(4, 1, 0)}, to_reach=False) is None
    route = armed.find_route((0, 1, 0), {(4, 1, 0)}, to_reach=False)
    assert {cell for move in route for cell in move.digs} == {(2, 1, 0), (2, 2, 0)}


def test_it_stays_away_from_lava_and_digs_nothing_beside_it(terrain_of):
    lava = {(2, 0, z): "lava" for z in range(-10, 3)}
    route = terrain_of(lava, {"stone": 1.0}).find_route((0, 1, 0), {(4, 1, 0)}, to_reach=False)
    assert all(abs(x - 2) + abs(z - min(z, 2)) > 0 for x, _, z in list_cells(route))
    assert (2, 1, 0) not in list_cells(route)


def test_a_gap_is_bridged_by_blocks_that_are_carried_alone(terrain_of):
    gap = {cell: "air" for size in (1, 2) for cell in list_ring(size, range(-10, 1))}
    assert terrain_of(gap, {}).find_route((0, 1, 0), {(3, 1, 0)}, to_reach=False) is None
    route = terrain_of(gap, {}, blocks=9).find_route((0, 1, 0), {(3, 1, 0)}, to_reach=False)
    assert [move.put for move in route if move.put] == [(1, 0, 0), (2, 0, 0)]


def test_a_node_is_reached_only_in_view_and_near(terrain_of):
    terrain = terrain_of({(0, -3, 0): "ore"}, {"stone": 1.0, "ore": 1.0})
    assert terrain.can_reach((0, 1, 0), (0, 0, 0))
    assert not terrain.can_reach((0, 1, 0), (0, -1, 0)), "behind the node on which it stands"
    assert not terrain.can_reach((0, 1, 0), (6, 0, 0)), "too far"
    route = terrain.find_route((0, 1, 0), {(0, -3, 0)}, to_reach=True)
    assert terrain.can_reach(route[-1].to, (0, -3, 0)) or route[-1].digs


def test_there_are_as_many_tasks_as_in_the_groups_of_the_benchmark():
    assert [len(items) for items in GROUPS.values()] == [10, 9, 16, 6, 7, 6, 13]
    assert all(len({*items}) == len(items) for items in GROUPS.values())


@pytest.mark.slow
@pytest.mark.parametrize("item", ["group_wood", "default_stone", "mesecons_walllever_wall_lever_off", "default_mese"])
def test_a_task_is_planned_from_bare_hands_by_the_book(item, tmp_path):
    graph = yaml.safe_load(write_goal([item], tmp_path, Library.open(LIBRARY)).read_text())
    assert graph["accept"] == [f"holds({item}) >= 1"]
    first = [name for name, node in graph["sessions"].items() if not node.get("after")]
    assert {graph["sessions"][name]["with"]["what"] for name in first} == {"group_tree"}


def test_what_no_recipe_makes_has_no_plan(tmp_path):
    with pytest.raises(ValueError, match="no plan for default_nyan"):
        write_goal(["default_nyan"], tmp_path, Library.open(LIBRARY))


def test_a_task_counts_by_its_last_outcome_and_a_group_by_its_tasks(tmp_path):
    lines = [
        {"group": "Wood", "item": "default_stick", "seed": 1, "is_met": False},
        {"group": "Wood", "item": "default_stick", "seed": 1, "is_met": True},
        {"group": "Wood", "item": "default_stick", "seed": 2, "is_met": False},
    ]
    file = tmp_path / "outcomes.jsonl"
    file.write_text("".join(json.dumps(each) + "\n" for each in lines))
    assert sum_up(read_outcomes(file).values()) == {"wood_tried": 2, "wood_met": 0.5}


class FakeLink:
    """A player who stands at (0, 1, 0) between two nodes of stone, with one above."""

    def __init__(self, **items):
        self.nodes, self.dug = {(0, 2, 0): 1, (0, 1, 0): 0, (1, 1, 0): 1}, []
        self.items = {f"default:{name}": count for name, count in items.items()}

    def call(self, name, **given):
        if name == "book":
            nodes = {each: kind | {"tools": {"": 1.0}} for each, kind in NODES.items()}
            return {"recipes": {}, "nodes": nodes, "groups": {}, "ground": {}}
        if name == "dig":
            self.dug.append(given["at"])
            self.nodes[given["at"]] = 0
            self.items.pop("default:pick_stone", None)  # it was all but worn out
        if name == "craft":
            self.items |= {given["item"]: 1, "default:stick": self.items["default:stick"] - 2}
        nodes = [number for cell, kind in self.nodes.items() for number in (*cell, kind)]
        about = {"at": (0, 1, 0), "hp": 20, "breath": 10, "day": 0.5, "light": 14, "items": self.items, "creatures": []}
        return about | {"names": ["air", "stone"], "nodes": nodes, "times": {"stone": 1.0}}


def dig_beside(link):
    from luanti_body.agent import Agent

    agent = Agent(link, heading=0)
    for action in agent.dig((1, 1, 0)):
        agent.act(action, 0.1)
    return agent


@pytest.mark.usefixtures("terrain_of")
def test_what_fell_onto_the_player_is_dug_before_anything_else():
    link = FakeLink()
    dig_beside(link)
    assert link.dug == [(0, 2, 0), (1, 1, 0)]


@pytest.mark.usefixtures("terrain_of")
def test_a_pick_that_wears_out_in_a_search_is_made_anew_of_what_is_carried():
    assert dig_beside(FakeLink(pick_stone=1, stick=5, cobble=9)).items["default:stick"] == 1
    assert dig_beside(FakeLink(stick=5, cobble=9)).items["default:stick"] == 5, "it never had one"
    assert dig_beside(FakeLink(pick_stone=1, stick=1, cobble=9)).items["default:stick"] == 1
