"""The table of mutants for people, `docs/gauntlet.md`: which claim turns which tests red."""

from tests.mutants.mutant import ROOT, Mutant
from tests.mutants.register import MUTANTS

PAGE = ROOT / "docs" / "gauntlet.md"

HEAD = """# Mutation tests

Tests that pass prove little until it is known what makes them fail. Each line below is one mutant: a few bent lines of
our own source, and what the system then claims. With a mutant planted, **every** test named beside it must turn red;
without it, all of them are green. `make mutants` proves both; the usual tests only check that each can be planted.

- A mutant is planted when a module is imported, in the process of the tests and in every process that it starts. The
  source on the disk, and the cache of byte code, stay as they are.
- Red means that the test's own question was answered with no. An error of import or collection, a fixture that breaks,
  a mistake in the bent lines and a test that runs out of time count as *not* red.
- `make mutants MUTANTS="NAME ..."` plants those that are named, and prints what each test said and the seconds it took.
  `python -m tests.mutants --write` renews this page, which a fast test compares with the register.

To add one, put a `Mutant` into `tests/mutants/claims/` and renew the page. One that turns nothing red has found a
missing test: write that first.
"""


def render_page() -> str:
    """The page as it must stand in `docs/gauntlet.md`."""
    tests = {node for mutant in MUTANTS for node in mutant.tests}
    count = f"{len(MUTANTS)} mutants, {len(tests)} different tests.\n"
    lines = ["| mutant | what it claims | where | tests that turn red |", "|---|---|---|---|"]
    return f"{HEAD}\n{count}\n" + "\n".join([*lines, *map(_render_line, MUTANTS)]) + "\n"


def _render_line(mutant: Mutant) -> str:
    modules = dict.fromkeys(edit.module.removeprefix("phyagentos.") for edit in mutant.edits)
    where = ", ".join(f"`{module}`" for module in modules)
    tests = "<br>".join(f"[{name}](../{file})" for file, _, name in (node.partition("::") for node in mutant.tests))
    return f"| `{mutant.name}` | {mutant.claim} | {where} | {tests} |"
