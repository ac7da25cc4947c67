"""The weight of the code in statements of the syntax tree: `make weigh`.

Imports, docstrings and other bare constants do not count, and neither do comments, blank lines or the number of files:
nothing is gained by squeezing. A room is a top-level package, or a package of one of the large rooms.
"""

import argparse
import ast
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

FOLDERS = ("phyagentos", "kits", "tests", "benchmarks", "examples", "tools")
LARGE_ROOMS = ("agent", "runtime", "store", "protocol")  # of phyagentos: shown by package
LONG_FUNCTION = 50  # lines


def count_statements(source: str) -> int:
    """Statements without imports and bare constants."""
    return sum(isinstance(node, ast.stmt) and not _is_free(node) for node in ast.walk(ast.parse(source)))


def iter_long_functions(source: str) -> Iterator[tuple[str, int, int]]:
    """Name, first line and number of lines of each function that is longer than `LONG_FUNCTION`."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            if lines > LONG_FUNCTION:
                yield node.name, node.lineno, lines


def count_any(source: str) -> int:
    """How often a name `Any` stands in the code."""
    return sum(isinstance(node, ast.Name) and node.id == "Any" for node in ast.walk(ast.parse(source)))


def name_room(file: Path) -> str:
    """`file` is relative to the folder that is weighed."""
    parents = file.parts[:-1]
    depth = 2 if parents and parents[0] in LARGE_ROOMS else 1
    return "/".join(parents[:depth]) or "."


def weigh(folder: Path) -> Counter[str]:
    """Statements of each room."""
    rooms: Counter[str] = Counter()
    for file in sorted(folder.rglob("*.py")):
        rooms[name_room(file.relative_to(folder))] += count_statements(file.read_text(encoding="utf-8"))
    return rooms


def _is_free(node: ast.stmt) -> bool:
    is_bare = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return is_bare or isinstance(node, ast.Import | ast.ImportFrom)


def main() -> None:
    """Print a table by room, then what a reader would meet: long functions, `Any`, file names that stand often."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", nargs="?", type=Path, default=Path(__file__).parents[1], help="A checkout.")
    parser.add_argument("--json", action="store_true", help="One line of JSON.")
    options = parser.parse_args()
    rooms = {folder: weigh(options.root / folder) for folder in FOLDERS}
    package = sorted((options.root / "phyagentos").rglob("*.py"))
    sources = {file.relative_to(options.root): file.read_text(encoding="utf-8") for file in package}
    longest = [(file, *found) for file, source in sources.items() for found in iter_long_functions(source)]
    names = Counter(file.name for file in sources if file.name != "__init__.py")
    often = {name: count for name, count in names.items() if count > 2}
    any_ = sum(map(count_any, sources.values()))
    if options.json:
        totals = {folder: sum(found.values()) for folder, found in rooms.items()}
        print(json.dumps(totals | {"any": any_, "long_functions": len(longest), "names_thrice": sorted(often)}))
        return
    for folder, found in rooms.items():
        print(f"{folder:<28}{sum(found.values()):>8}")
        for room, count in found.most_common():
            print(f"  {room:<26}{count:>8}")
    print(f"\nfunctions over {LONG_FUNCTION} lines: {len(longest)}")
    for file, name, line, lines in sorted(longest, key=lambda each: -each[3]):
        print(f"  {file}:{line} {name} ({lines})")
    print(f"names `Any` in phyagentos: {any_}")
    standing = ", ".join(f"{name} ({often[name]})" for name in sorted(often))
    print(f"file names that stand more than twice: {standing or 'none'}")


if __name__ == "__main__":
    main()
