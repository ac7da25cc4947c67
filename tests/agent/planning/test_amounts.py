"""Plans by amounts: recipes become sessions that a simulator of its own carries out, or a proof that there are none."""

import itertools
import math
import random
import time
from pathlib import Path

import networkx as nx
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.spec import Budget, WantedGoal
from phyagentos.agent.planning import integer_program
from phyagentos.agent.planning.answers import Missing, PlannedGoal, UnreachableReason, Unsolvable
from phyagentos.agent.planning.planned import plan_goal, write_graph
from phyagentos.agent.planning.recipe_domain import build_recipe_domain
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.recipes import Recipe, read_recipes
from phyagentos.protocol.world.environment import Entity, Pose, TargetState
from tests.protocol.predicate_worlds import world

PROJECT = Path(__file__).parent / "crafting"
CATALOGUE = Catalogue.read(Library.open(PROJECT))
BOOK = [
    (path.parent.name, entry)
    for path in sorted(PROJECT.glob("skills/*/recipes.yaml"))
    for entry in yaml.safe_load(path.read_text())["recipes"]
]
NOTHING = world()


def look(inventory=None, vitals=None, nearby=(), **more):
    report = {"inventory": inventory or {}, "vitals": vitals or {}, "nearby": nearby}
    state = TargetState(q_rad=(), qd_rad_s=(), gripper_width_m=0.0, tcp=Pose(), **report)
    return world(targets={"panda": state}, **more)


def plan(*accept, now=NOTHING, catalogue=CATALOGUE, without=(), **more):
    fields = {"goal": "g", "objective": "o", "scene": "s", "targets": {"player": "panda"}}
    return plan_goal(WantedGoal(**fields, accept=accept, **more), catalogue, now, without)


def find_missing(answer):
    assert isinstance(answer, Unsolvable), answer
    assert answer.is_proven
    return answer.missing


def test_a_search_that_takes_long_ends_with_what_it_has_found(monkeypatch):
    monkeypatch.setattr(integer_program, "LONG_S", 0.2)

    found = plan("holds(piston) >= 2", "holds(stick) <= 1", steps=(("holds(stick) >= 8",),))

    assert isinstance(found, PlannedGoal) or (found.missing[0].lack, found.is_proven) == (UnreachableReason.TIME, False)


class Game:
    """A game of its own, one application at a time: an item that is worn through is gone."""

    def __init__(self, inventory=(), vitals=(), stations=()):
        self.items, self.worn = dict(inventory), {}
        self.vitals, self.stations, self.time_s = dict(vitals), set(stations), 0.0
        self.lasts = {entry["item"]: entry["lasts"] for _, entry in BOOK if "lasts" in entry}

    def count(self, item):
        return self.items.get(item, 0)

    def can(self, entry):
        has = all(self.count(item) >= count for item, count in entry.get("uses", {}).items())
        return has and all(map(self.count, entry.get("needs", ()))) and self.stations.issuperset(entry.get("at", ()))

    def apply(self, entry):
        assert self.can(entry), entry
        for item, count in entry.get("uses", {}).items():
            self.items[item] -= count
        for tool in {*entry.get("needs", ())} & self.lasts.keys():
            self.worn[tool] = self.worn.get(tool, 0) + 1
            if self.worn[tool] == self.lasts[tool]:
                self.worn[tool], self.items[tool] = 0, self.items[tool] - 1
        for vital, change in entry.get("vitals", {}).items():
            if vital in self.vitals:
                self.vitals[vital] = min(self.vitals[vital] + change, entry.get("up_to", math.inf))
                assert self.vitals[vital] >= 0, entry
        self.stations |= {entry["station"]} if "station" in entry else set()
        if "item" in entry:
            self.items[entry["item"]] = self.count(entry["item"]) + entry.get("makes", 1)
        self.time_s += entry.get("time_s", 1.0)

    def play(self, problem, action):
        """One action of a PDDL domain, which ends with the number of its activity."""
        activity = problem.activities[int(action.removesuffix("_full").rpartition("_")[2])]
        given, made = dict(activity.parameters), activity.made.subject
        fits = [e for skill, e in BOOK if skill == activity.skill and self.makes(e, given) and made in str(e)]
        self.apply(next(e for e in fits if self.can(e)))

    def meets(self, text):
        item, relation, bound = (text if " " in text else f"{text} >= 1").replace("holds(", "").replace(")", "").split()
        return self.count(item) >= int(bound) if relation == ">=" else self.count(item) <= int(bound)

    def carry_out(self, step):
        """Apply recipes of the skill until what it guarantees is so."""
        given = dict(step.parameters)
        for _ in range(10_000):
            if self.is_done(given):
                return
            fits = [e for skill, e in BOOK if skill == step.skill and self.makes(e, given) and self.can(e)]
            assert fits, f"{step.name}: nothing can be done with {self.items} at {self.stations}"
            self.apply(fits[-1])
        raise AssertionError(step)

    def makes(self, entry, given):
        made = {key: entry[key] for key in ("item", "station") if key in entry} | entry.get("with", {})
        return made.items() <= given.items()

    def is_done(self, given):
        if "level" in given:
            return self.vitals["food"] >= given["level"]
        return given["station"] in self.stations if "station" in given else self.count(given["item"]) >= given["count"]


def carry_out(planned, game, rng=None):
    """All sessions, in the order of the plan or in any that it allows."""
    assert isinstance(planned, PlannedGoal), planned
    left = {step.name: step for step in planned.steps}
    done = set()
    while left:
        ready = [step for step in left.values() if done.issuperset(step.after)]
        step = ready[0] if rng is None else rng.choice(ready)
        game.carry_out(left.pop(step.name))
        done.add(step.name)
    return game


@pytest.mark.slow
def test_an_item_of_iron_and_gold_is_made_from_bare_hands_within_two_seconds():
    begin_s = time.process_time()
    planned = plan("holds(clock)")
    took_s = time.process_time() - begin_s
    game = carry_out(planned, Game())
    assert game.count("clock") == 1
    assert took_s <= 2.0
    names = [step.name for step in planned.steps]
    assert (names[0], names[-1], len(names)) == ("collect_log", "craft_clock", len(set(names)))
    assert planned.steps[-1].accept == ("holds(clock)",)
    assert {"craft_iron_pickaxe", "smelt_gold_ingot", "set_up_furnace"} < set(names)


@pytest.mark.slow
def test_every_order_that_a_plan_allows_reaches_its_goal():
    planned = plan("holds(clock)", "holds(piston) >= 2")
    orders = [carry_out(planned, Game(), random.Random(seed)) for seed in range(30)]
    assert all(game.count("clock") == 1 and game.count("piston") == 2 for game in orders)
    graph = nx.DiGraph((before, step.name) for step in planned.steps for before in step.after)
    assert len([*itertools.islice(nx.all_topological_sorts(graph), 3)]) == 3  # there are several


ITEMS = st.sampled_from(("log", "planks", "stick", "cobblestone", "coal", "iron_ingot", "table", "stone_pickaxe"))


@settings(max_examples=25, deadline=None)
@given(
    st.dictionaries(ITEMS, st.integers(1, 9), max_size=4),
    st.dictionaries(ITEMS, st.integers(1, 20), min_size=1, max_size=3),
)
@pytest.mark.slow
def test_a_plan_from_any_inventory_reaches_any_amounts(inventory, wanted):
    planned = plan(*(f"holds({item}) >= {count}" for item, count in wanted.items()), now=look(inventory))
    game = carry_out(planned, Game(inventory))
    assert all(game.count(item) >= count for item, count in wanted.items())
    met = all(inventory.get(item, 0) >= count for item, count in wanted.items())
    assert (planned.steps == ()) is met


def test_what_is_carried_and_what_stands_is_not_made_again():
    now = look({"iron_pickaxe": 1, "coal": 4}, nearby=("table",))
    furnace = Entity(name="furnace_1", kind="furnace", pose=Pose(), movable=False)
    planned = plan("holds(clock)", now=look({"iron_pickaxe": 1, "coal": 4}, nearby=("table",), entities={"f": furnace}))
    skills = {step.skill for step in planned.steps}
    assert skills == {"collect", "smelt", "craft"}
    assert carry_out(planned, Game({"iron_pickaxe": 1, "coal": 4}, stations={"table", "furnace"})).count("clock") == 1
    assert "set_up" in {step.skill for step in plan("holds(clock)", now=now).steps}  # no furnace is in sight


def test_a_tool_that_wears_is_made_again():
    planned = plan("holds(cobblestone) >= 70", now=look({"wooden_pickaxe": 1}))
    game = carry_out(planned, Game({"wooden_pickaxe": 1}))
    assert game.count("cobblestone") == 70
    assert [s for s in planned.steps if s.parameters.get("item") in {"wooden_pickaxe", "stone_pickaxe"}]
    alone = plan("holds(cobblestone) >= 59", now=look({"wooden_pickaxe": 1}))
    assert [step.name for step in alone.steps] == ["collect_cobblestone"]


def iter_vitals(planned, vitals):
    game = Game({}, vitals)
    for step in planned.steps:
        game.carry_out(step)
        yield dict(game.vitals)


def test_a_vital_is_kept_above_what_a_constraint_says():
    keep = ("vital(food) >= 3",)
    planned = plan("holds(beef) >= 12", now=look(vitals={"food": 5.0}), constraints=keep)
    assert [step.skill for step in planned.steps].count("eat") >= 2
    lowest = min(state["food"] for state in iter_vitals(planned, {"food": 5.0}))
    assert lowest >= 3.0
    game = carry_out(planned, Game({}, {"food": 5.0}))
    assert game.count("beef") >= 12
    unfed = plan("holds(beef) >= 12", now=look(), constraints=())
    assert [step.skill for step in unfed.steps] == ["collect"]  # food that nothing reports costs nothing


@pytest.mark.parametrize(
    ("wanted", "lack", "names"),
    [
        ("holds(beacon)", UnreachableReason.PRECONDITION, ("holds(nether_star)", "holds(obsidian)")),
        ("holds(shears)", UnreachableReason.PRECONDITION, ("nearby(anvil)",)),
        ("holds(feather) >= 2", UnreachableReason.PREDICATE, ()),
    ],
)
def test_an_item_that_can_never_be_had_is_proven_and_named_with_what_is_missing(wanted, lack, names):
    assert find_missing(plan(wanted)) == (Missing(lack, wanted.split(" ")[0], names),)


def test_tools_that_need_each_other_cannot_be_had():
    knot = [Recipe(item="a", needs=("b",)), Recipe(item="b", needs=("a",))]
    assert find_missing(plan("holds(a)", catalogue=with_recipes(knot)))[0].names == ("holds(a)", "holds(b)")
    assert carry_out_trivially(plan("holds(a) >= 2", now=look({"b": 1}), catalogue=with_recipes(knot)))


def with_recipes(recipes):
    skill = CATALOGUE.skills["craft"].model_copy(update={"recipes": tuple(recipes)})
    return Catalogue(skills={"craft": skill}, targets=CATALOGUE.targets, scenes={})


def carry_out_trivially(planned):
    return isinstance(planned, PlannedGoal) and len(planned.steps)


def test_amounts_that_cannot_suffice_are_proven_with_what_is_short():
    bench = [r for r in CATALOGUE.skills["craft"].recipes if r.item in {"planks", "stick"}]
    catalogue = with_recipes(bench)
    carried = look({"log": 2})
    assert isinstance(plan("holds(stick) >= 16", now=carried, catalogue=catalogue), PlannedGoal)
    assert isinstance(plan("holds(planks) >= 4", "holds(stick) >= 8", now=carried, catalogue=catalogue), PlannedGoal)
    (missing,) = find_missing(plan("holds(planks) >= 5", "holds(stick) >= 8", now=carried, catalogue=catalogue))
    assert (missing.lack, missing.names) == (UnreachableReason.AMOUNT, ("1 log",))
    assert "1 log more" in missing.describe()


def test_a_goal_beyond_the_limits_is_not_called_impossible():
    answer = plan("holds(log) >= 9000")
    assert isinstance(answer, Unsolvable)
    assert not answer.is_proven


def test_time_is_a_resource():
    needed_s = carry_out(plan("holds(planks) >= 8"), Game()).time_s
    assert needed_s == 8.0  # two logs of 3 s, two times 1 s
    assert isinstance(plan("holds(planks) >= 8", budget=Budget(sim_time_s=8.0)), PlannedGoal)
    (missing,) = find_missing(plan("holds(planks) >= 8", budget=Budget(sim_time_s=7.0)))
    assert (missing.lack, missing.names) == (UnreachableReason.AMOUNT, ("1 s",))


def test_steps_come_true_in_their_order():
    planned = plan("not holds(stick)", steps=[("holds(stick) >= 8",), ("holds(table)",)], now=look({"log": 3}))
    game, seen = Game({"log": 3}), []
    for step in planned.steps:
        game.carry_out(step)
        seen.append((game.count("stick") >= 8, game.count("table") >= 1))
    assert seen.index((True, False)) < seen.index((True, True))  # eight sticks, then a table
    assert game.count("stick") == 0  # which only pickaxes use up
    assert game.count("wooden_pickaxe") == 4
    accepted = [text for step in planned.steps for text in step.accept]
    assert accepted[0] == "holds(stick) >= 8"


def test_a_limit_that_nothing_can_keep_is_a_contradiction():
    (missing,) = find_missing(plan("holds(log) >= 3", "holds(log) <= 2"))
    assert (missing.lack, missing.names) == (UnreachableReason.CONTRADICTION, ("holds(log) >= 3", "holds(log) <= 2"))


def test_a_session_that_was_tried_in_vain_is_not_planned_again():
    tried = ("collect", "panda", {"item": "log", "count": 1})
    assert isinstance(plan("holds(planks) >= 4"), PlannedGoal)
    assert isinstance(plan("holds(planks) >= 4", without=[tried]), Unsolvable)


def test_statements_of_other_objects_must_be_true_already():
    with pytest.raises(DefinitionError, match="NO_CANDIDATE"):
        plan("holds(log)", "visible(tree)")
    with pytest.raises(DefinitionError, match="NO_CANDIDATE"):
        plan("holds(log) or holds(stick)")


def test_the_goal_graph_of_a_plan_says_how_much_there_is_after_each_session():
    graph = yaml.safe_load(write_graph(plan("holds(stick) >= 6", budget=Budget(sessions=5))))
    assert graph["sessions"]["craft_stick"]["with"] == {"item": "stick", "count": 8}
    assert graph["sessions"]["craft_stick"]["accept"] == ["holds(stick) >= 6"]
    assert graph["budget"] == {"sessions": 5}


def test_a_book_says_what_is_wrong_at_its_place(tmp_path):
    book = tmp_path / "recipes.yaml"
    book.write_text("recipes:\n  - {item: a, station: b}\n  - {item: a, makes: 0}\n  - {vitals: {food: 1}}\n")
    with pytest.raises(DefinitionError) as caught:
        read_recipes(book)
    assert [each.address.rpartition("recipes.yaml:")[2] for each in caught.value.problems] == ["2:5", "3:15", "4:6"]


def test_what_a_session_lacks_is_found_by_the_recipe_that_lacks_least():
    wanted = WantedGoal(
        goal="g", objective="o", scene="s", targets={"player": "panda"}, accept=("holds(iron_ore) >= 2",)
    )
    tried = ("collect", "panda", {"item": "iron_ore", "count": 2})
    worn = build_recipe_domain(wanted, CATALOGUE, look({"wooden_pickaxe": 1}))
    whole = build_recipe_domain(wanted, CATALOGUE, look({"stone_pickaxe": 1}))
    assert [domain.find_unmet(tried) for domain in (worn, whole)] == [("holds(stone_pickaxe) >= 1",), ()]
