#!/usr/bin/env python
"""Executes a notebook in an empty folder, and keeps in it what its cells show.

    python tools/execute_notebook.py docs/episodes.ipynb

`executed` in its metadata is the hash of the cells that ran: a test compares it with those that stand there.
"""

import hashlib
import json
import os
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.api.notebooks import execute, read_cells


def main() -> None:
    """Execute the notebook that is named."""
    path = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        shown = execute(path)
        os.chdir(path.parent)
    notebook = json.loads(path.read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for number, (cell, html) in enumerate(zip(cells, shown, strict=True), 1):
        data = {"text/html": html.splitlines(keepends=True)}
        output = {"output_type": "display_data", "data": data, "metadata": {}}
        cell.update(execution_count=number, outputs=[output] if html else [])
    notebook["metadata"]["executed"] = hashlib.sha256("\n".join(read_cells(path)).encode()).hexdigest()
    path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
