"""Write the game's own book as the recipes of skills, for the planner of amounts.

    python -m luanti_body.write_books SKILLS KIND...

SKILLS is a folder with `gather`, `craft` and `smelt`; each gets the recipes of the kinds named, and of what they need.
"""

import json
import sys
from pathlib import Path

from luanti_body.book import Book, render_recipes
from luanti_body.world import open_server


def main(skills: Path, wanted: list[str]) -> None:
    """Ask a server that is started for it, and write `recipes.yaml` of each skill."""
    with open_server() as world:
        books = render_recipes(Book(**world.link.call("book")), wanted)
    for skill, recipes in books.items():
        lines = [f"  - {json.dumps(each)}\n" for each in recipes]
        text = (
            "# By `python -m luanti_body.write_books`: the game's book; times of searching are estimates.\nrecipes:\n"
        )
        (skills / skill / "recipes.yaml").write_text(text + "".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
