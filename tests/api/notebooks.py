"""Runs what documents show: the code cells of a notebook, or the Python of a page, in order and in one namespace."""

import ast
import contextlib
import html
import io
import json
import re
from pathlib import Path
from typing import Any

_FENCE = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def read_cells(path: Path) -> list[str]:
    """The code cells of a `.ipynb`, or the Python blocks of a `.md`."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return _FENCE.findall(text)
    return ["".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]


def execute(path: Path) -> list[str]:
    """What each cell prints, and shows at its end as a notebook would, as HTML; empty where it does neither.

    Whatever a cell raises leaves this function, with the number of the cell as a note.
    """
    namespace: dict[str, Any] = {"__name__": "__main__"}
    shown = []
    for number, cell in enumerate(read_cells(path), 1):
        try:
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                value = _execute(cell, f"{path.name}[{number}]", namespace)
            shown.append(html.escape(printed.getvalue()) + value)
        except Exception as error:
            error.add_note(f"in cell {number} of {path}")
            raise
    return shown


def _execute(cell: str, name: str, namespace: dict[str, Any]) -> str:
    tree = ast.parse(cell, name)
    last = tree.body.pop() if tree.body and isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, name, "exec"), namespace)
    if last is None:
        return ""
    value = eval(compile(ast.Expression(last.value), name, "eval"), namespace)
    if value is None:
        return ""
    return value._repr_html_() if hasattr(value, "_repr_html_") else html.escape(repr(value))
