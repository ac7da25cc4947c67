"""The table of the gauntlet, for `docs/gauntlet.md`: which lie turns which tests red.

Upstream: the register, whose every line `test_gauntlet` proves. Downstream: people.
"""

from tests.gauntlet.sabotage import ROOT, Sabotage
from tests.gauntlet.sabotages import SABOTAGES

PAGE = ROOT / "docs" / "gauntlet.md"

HEAD = """# A gauntlet of lies

Tests that pass prove little until it is known what makes them fail. Each line below is one sabotage of our own code or
evidence: a lie, told by a few bent lines of source. With the lie planted, **every** test named beside it must turn red;
without it, all of them are green. `pytest tests/gauntlet` proves both, within the group `sim` of the usual tests.

- A lie is planted when a module is imported, in the process of the tests and in every process that it starts. The
  source on the disk, and the cache of byte code, stay as they are.
- Red means that the test's own question was answered with no. An error of import or collection, a fixture that breaks,
  a mistake in the bent lines and a test that runs out of time count as *not* red.
- A lie whose lines are no longer found in the source is an error of the gauntlet, reported by a fast test.
- `python -m tests.gauntlet` runs them all, or those that are named, and prints what each test said and the seconds it
  took. `python -m tests.gauntlet --write` renews this page, which a fast test compares with the register.

To add one, put a `Sabotage` into `tests/gauntlet/lies/` and renew the page. One that turns nothing red has found a
missing test: write that first.
"""


def render_page() -> str:
    """The page as it must stand in `docs/gauntlet.md`."""
    tests = {node for sabotage in SABOTAGES for node in sabotage.tests}
    count = f"{len(SABOTAGES)} sabotages, {len(tests)} different tests.\n"
    lines = ["| sabotage | the lie | where it is told | tests that turn red |", "|---|---|---|---|"]
    return f"{HEAD}\n{count}\n" + "\n".join([*lines, *map(_render_line, SABOTAGES)]) + "\n"


def _render_line(sabotage: Sabotage) -> str:
    modules = dict.fromkeys(edit.module.removeprefix("phyagentos.") for edit in sabotage.edits)
    where = ", ".join(f"`{module}`" for module in modules)
    tests = "<br>".join(_render_test(node) for node in sabotage.tests)
    return f"| `{sabotage.name}` | {sabotage.lie} | {where} | {tests} |"


def _render_test(node: str) -> str:
    file, _, name = node.partition("::")
    return f"[{name}](../{file})"
