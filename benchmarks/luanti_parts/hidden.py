"""Luanti with its book hidden: recipes of crafting and smelting are unknown, until a verdict has verified one.

Where items come from in the ground stays given. A recipe may be tried, as a set of items, once one of its ingredients
was held: it is a hypothesis of one life, whose goal is to carry what such sets make. Known is what KNOWLEDGE.md has.
"""

import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.recipes import RECIPES, Recipe, read_recipes
from phyagentos.protocol.documents.document import read_document
from phyagentos.protocol.sessions.knowledge import KNOWLEDGE

HIDDEN = ("craft", "smelt")
TRIED_MAX = 8  # sets of items of one life


@dataclass(frozen=True)
class HiddenBook:
    """The recipes that the agent does not know, by item, and what it can gather by what."""

    recipes: Mapping[str, Recipe]
    gathered: Sequence[Recipe]

    @classmethod
    def read(cls, library: Path) -> "HiddenBook":
        """Of the skills of a library."""
        books = {skill: read_recipes(library / "skills" / skill / RECIPES) for skill in (*HIDDEN, "gather")}
        return cls({each.item: each for skill in HIDDEN for each in books[skill]}, books["gather"])

    def list_reachable(self, known: set[str]) -> set[str]:
        """What can be carried by these recipes, and by gathering."""
        usable, found, is_new = (
            [*self.gathered, *(each for each in self.recipes.values() if each.item in known)],
            set[str](),
            True,
        )
        while is_new:
            more = {each.item for each in usable if found >= {*each.uses, *each.needs}} - found
            found |= more
            is_new = bool(more)
        return found

    def choose_trials(self, known: set[str], held: set[str]) -> list[str]:
        """What a life is to carry, the quickest first: sets of items that may be tried, and what else is in reach."""
        trials: list[str] = []
        while len(trials) < TRIED_MAX:
            done = known.union(trials)
            reachable = self.list_reachable(done)
            ready = {each.item for each in self.gathered} & reachable - held.union(trials)
            ready |= {
                item
                for item, each in self.recipes.items()
                if item not in done and held & {*each.uses} and reachable >= {*each.uses, *each.needs}
            }
            if not ready:
                break
            trials.append(min(ready, key=lambda item: (self.measure(item), item)))
        return trials

    def measure(self, item: str) -> float:
        """How long it takes to make or gather all that goes into one [s]."""
        if (recipe := self.recipes.get(item)) is None:
            return min(each.time_s for each in self.gathered if each.item == item)
        return recipe.time_s + sum(count * self.measure(each) for each, count in recipe.uses.items()) / recipe.makes


def write_known(library: Path, known: set[str], to: Path) -> Library:
    """A library whose books of crafting and smelting have these recipes alone."""
    shutil.copytree(library, to)
    for skill in HIDDEN:
        file = to / "skills" / skill / RECIPES
        kept = [each for each in yaml.safe_load(file.read_text(encoding="utf-8"))["recipes"] if each["item"] in known]
        file.write_text(yaml.safe_dump({"recipes": kept}), encoding="utf-8")
        if not kept:
            file.unlink()
    return Library.open(to)


def iter_verified(file: Path) -> Iterator[str]:
    """What a verdict has verified to be made or gathered, by the facts of KNOWLEDGE.md."""
    for fact in read_document(file.read_text(encoding="utf-8"), KNOWLEDGE, str(file)).blocks.values():
        if fact.supported and fact.scope.object:
            yield fact.scope.object
