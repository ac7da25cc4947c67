"""Recipes: what one application of a skill makes, of what, and where.

A book of recipes is declared data: `recipes.yaml` beside the SKILL.md of the skill that carries them out. Planning
reads it; a verdict never does.
"""

from pathlib import Path
from typing import Annotated

import pydantic

from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.documents.schema import Authored, misfit, read_yaml, validate

RECIPES = "recipes.yaml"
_Amount = Annotated[int, pydantic.Field(ge=1)]


class Recipe(Authored):
    """One application of a skill: an item that is made or gathered, a station that is set up, or vitals that it raises.

    Attributes:
        item: Kind of item that is carried afterwards.
        makes: So many of it.
        station: Kind of place that stands afterwards; it stays, and a skill that needs it goes there.
        vitals: What is added to each vital, in its own scale; negative where it costs.
        up_to: Above this no vital is raised.
        uses: Items that are used up.
        needs: Items that must be carried and stay; one that `lasts` is worn by one use.
        at: Stations that must stand.
        lasts: Uses of the item before it breaks; without end where it is left out.
        time_s: How long it takes, in the target's time [s].
        arguments: Of the skill (`with`), beside what it makes.
    """

    item: str = ""
    makes: _Amount = 1
    station: str = ""
    vitals: dict[str, float] = {}
    up_to: float | None = None
    uses: dict[str, _Amount] = {}
    needs: tuple[str, ...] = ()
    at: tuple[str, ...] = ()
    lasts: _Amount | None = None
    time_s: float = pydantic.Field(default=1.0, ge=0.0)
    arguments: Fields = pydantic.Field(default_factory=dict, alias="with")

    @pydantic.model_validator(mode="after")
    def _check_purpose(self) -> "Recipe":
        raises = [name for name, change in self.vitals.items() if change > 0]
        if bool(self.item) + bool(self.station) > 1 or not (self.item or self.station or raises):
            raise misfit("", "an item, a station, or a vital that it raises", "Write one recipe for each.")
        if raises and self.up_to is None:
            raise misfit("vitals", "`up_to`, the most that the vital can be", "Write `up_to: 9`.")
        return self


class RecipeBook(Authored):
    """The content of `recipes.yaml`.

    Attributes:
        recipes: In any order. Several that make the same from other items differ in their arguments (`with`).
    """

    recipes: tuple[Recipe, ...] = pydantic.Field(min_length=1)

    @pydantic.model_validator(mode="after")
    def _check_choice(self) -> "RecipeBook":
        used: dict[str, dict[str, int]] = {}
        for each in self.recipes:
            made = f"{each.item or each.station or sorted(each.vitals)} with {each.arguments}"
            if used.setdefault(made, each.uses) != each.uses:
                raise misfit("recipes", f"one choice of items for {made}", "Tell them apart by arguments (`with`).")
        return self


def read_recipes(path: Path) -> tuple[Recipe, ...]:
    """Read a book of recipes; raises DefinitionError with every problem at file:line:column."""
    return validate(RecipeBook, read_yaml(path)).recipes
