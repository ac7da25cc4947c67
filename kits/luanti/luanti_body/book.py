"""The game's own book, as the agent and its planner know it: kinds of items, where they come from, and recipes.

A kind is an item, by the game's name with `_` for `:`, or `group_wood` for any item of a group of which recipes take
any. `render_recipes` writes the books of the skills: of each kind the cheapest recipe, by our estimates of time.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

FUEL, FUEL_S = "default:coal_lump", 40.0
FURNACE = "default:furnace"
GROUP, HIDDEN = "group:", "not_in_creative_inventory"
PICKS = ("default:pick_wood", "default:pick_stone", "default:pick_steel")
LASTS = dict(zip(PICKS, (4, 8, 20), strict=True))  # finds that each survives, the path to them included: our estimate
SEARCH_S = 65.0  # of searching through stone, after which a pick of stone is worn out
SPARE = 3.0  # of the mean of a search, whose time is exponential: 19 of 20 are shorter
STICK, COBBLE = "default:stick", "default:cobble"
OF_PICK = {STICK: 2, COBBLE: 3}  # what a pick of stone is made of; cobble comes with the digging
ON_GROUND_S, CRAFT_S = 5.0, 0.5


def name_item(item: str) -> str:
    """The game's name as predicates can have it: `default_tree` of `default:tree`."""
    name = item.replace(",", "_and_").replace(":", "_")
    return f"_{name}" if name[:1].isdigit() else name


@dataclass(frozen=True)
class Recipe:
    """One application: `skill` makes so many of a kind."""

    skill: str
    makes: int
    uses: Counter[str]
    time_s: float
    needs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Book:
    """What a server has registered, as the mod's call `book` gives it.

    Attributes:
        ground: Nodes of which the ground is made: how long one more is searched for, about [s]; 0 where it is common.
    """

    recipes: Mapping[str, Sequence[Mapping[str, Any]]]
    nodes: Mapping[str, Mapping[str, Any]]
    groups: Mapping[str, Sequence[str]]
    ground: Mapping[str, float]

    def list_members(self, wanted: str) -> list[str]:
        """Items that are an ingredient of a recipe, `group:a,b` or an item."""
        if not wanted.startswith(GROUP):
            return [wanted]
        sets = [{*self.groups.get(each, ())} for each in wanted.removeprefix(GROUP).split(",")]
        return sorted(set.intersection(*sets) - {*self.groups[HIDDEN]})

    def name_kind(self, wanted: str) -> str:
        """The kind of an ingredient; a group of one item is that item."""
        members = self.list_members(wanted)
        return name_item(members[0] if len(members) == 1 else wanted)

    @cached_property
    def groups_used(self) -> dict[str, list[str]]:
        """Groups of several items of which recipes take any, and these items, by kind."""
        wanted = {item for each in self.recipes.values() for recipe in each for item in recipe["items"]}
        found = {self.name_kind(each): self.list_members(each) for each in sorted(wanted) if each.startswith(GROUP)}
        return {kind: members for kind, members in found.items() if len(members) > 1}

    @cached_property
    def kinds(self) -> dict[str, list[str]]:
        """Every kind, and its items."""
        items = {*self.recipes, *self.nodes}.union(
            *self.groups.values(), *(n["drops"] or () for n in self.nodes.values())
        )
        return {self.name_kind(each): [each] for each in sorted(items) if each} | self.groups_used

    def list_sources(self, kind: str) -> list[str]:
        """Nodes of the ground, and trees, that drop an item of a kind when they are dug."""
        items, natural = {*self.kinds[kind]}, {*self.ground, *self.groups["tree"]}
        return sorted(name for name in natural if items & {*(self.nodes[name]["drops"] or ())})

    def iter_recipes(self, kind: str) -> Iterator[Recipe]:
        """All manners to come by a kind."""
        dug = [(self.ground.get(name, 0.0), self.nodes[name]["tools"]) for name in self.list_sources(kind)]
        is_hard = not any({"", PICKS[0]} & {*tools} for _, tools in dug)
        for tool in ("", *PICKS):
            if times := [(search + tools[tool], search) for search, tools in dug if tool in tools]:
                time_s, search_s = min(times)
                worn = math.ceil(SPARE * search_s / SEARCH_S) if is_hard else 0
                needs = (self.name_kind(tool),) if tool else ()
                uses = +Counter({self.name_kind(STICK): worn * OF_PICK[STICK]})
                yield Recipe("gather", 1, uses, ON_GROUND_S + time_s, needs)
                if not tool:
                    break
        for each in (recipe for item in self.kinds[kind] for recipe in self.recipes.get(item, ())):
            uses = Counter(map(self._lift if kind in self.groups_used else self.name_kind, each["items"]))
            makes = int(each["output"].partition(" ")[2] or 1)
            if each["method"] == "normal":
                yield Recipe("craft", makes, uses, CRAFT_S)
            elif each["method"] == "cooking":
                uses[self.name_kind(FUEL)] += math.ceil(each["time"] / FUEL_S)
                yield Recipe("smelt", makes, uses, each["time"], (self.name_kind(FURNACE), self.name_kind(PICKS[1])))

    def _lift(self, item: str) -> str:
        """The group of an item, for groups whose items are each made of one of another group: planks of trees."""
        return next((kind for kind, members in self.groups_used.items() if item in members), self.name_kind(item))

    def choose_recipes(self) -> dict[str, list[Recipe]]:
        """The cheapest skill for each kind that can be had, and its recipes: one, or one for each tool."""
        every = {kind: [*self.iter_recipes(kind)] for kind in self.kinds}
        costs, chosen, is_new = dict[str, float](), dict[str, Recipe](), True
        while is_new:
            is_new = False
            for kind, recipes in every.items():
                ready = [each for each in recipes if costs.keys() >= {*each.uses, *each.needs}]
                best = min(ready, key=lambda each: _measure(each, costs), default=None)
                if best is not None and _measure(best, costs) < costs.get(kind, math.inf):
                    costs[kind], chosen[kind], is_new = _measure(best, costs), best, True
        return {
            kind: [each for each in every[kind] if each.skill == "gather"] if best.skill == "gather" else [best]
            for kind, best in chosen.items()
        }


def _measure(recipe: Recipe, costs: Mapping[str, float]) -> float:
    """What one application costs, however many it makes."""
    return recipe.time_s + sum(n * costs[each] for each, n in recipe.uses.items())


def render_recipes(book: Book, wanted: Sequence[str]) -> dict[str, list[dict[str, Any]]]:
    """The books of the skills `gather`, `craft` and `smelt`, of these kinds and of all that they are made of.

    Where a group is taken, and one of its items by name, too, the item stands for the group: what is carried of it
    would count twice.
    """
    chosen = book.choose_recipes()
    known = _find_ingredients(chosen, wanted)
    gathered = {kind for kind in known if chosen[kind][0].skill == "gather" and kind not in book.groups_used}
    stand_in = {
        group: kind for group, items in book.groups_used.items() for kind in gathered & {*map(book.name_kind, items)}
    }
    lasts = {book.name_kind(pick): uses for pick, uses in LASTS.items()}
    found: dict[str, list[dict[str, Any]]] = {}
    for kind in sorted(known - stand_in.keys()):
        for each in chosen[kind]:
            uses = Counter[str]()
            for item, count in each.uses.items():
                uses[stand_in.get(item, item)] += count
            recipe = {"item": kind, "makes": each.makes, "uses": dict(sorted(uses.items())), "needs": [*each.needs]}
            recipe |= {"lasts": lasts.get(kind, 0), "time_s": round(each.time_s, 1)}
            defaults = {"makes": 1, "uses": {}, "needs": [], "lasts": 0}
            shown = {key: value for key, value in recipe.items() if value != defaults.get(key)}
            found.setdefault(each.skill, []).append(shown)
    return found


def _find_ingredients(chosen: Mapping[str, Sequence[Recipe]], wanted: Sequence[str]) -> set[str]:
    """Kinds, and all that they are made of and need, to the ground."""
    left, known = [*wanted], set[str]()
    while left:
        if (kind := left.pop()) not in known:
            known.add(kind)
            left += [item for each in chosen[kind] for item in (*each.uses, *each.needs)]
    return known
