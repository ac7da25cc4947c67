"""Bends the source of chosen modules when they are imported, in every Python process that has this folder on its path.

Upstream: `tests.gauntlet.running`, which names a file of edits in `GAUNTLET_EDITS`. Downstream: the import system of
the process and of every process that it starts. Source is replaced instead of attributes, so that a name which
somebody else has imported already is bent too; nothing that was bent is ever written to a cache of byte code.
"""

import json
import os
import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder, SourceFileLoader
from pathlib import Path


class BentLoader(SourceFileLoader):
    """Loads one module from bent source."""

    def __init__(self, fullname, path, edits):
        super().__init__(fullname, path)
        self._edits = edits

    def get_code(self, fullname):
        """Compile what the edits make of the source; the cache of byte code is neither read nor written."""
        source = Path(self.path).read_text(encoding="utf-8")
        for was, becomes in self._edits:
            if source.count(was) != 1:
                raise RuntimeError(f"sabotage of {fullname}: {was!r} stands there {source.count(was)} times")
            source = source.replace(was, becomes)
        return compile(source, self.path, "exec", dont_inherit=True)


class Bender(MetaPathFinder):
    """Finds the modules that are to be bent; everything else is found as always."""

    def __init__(self, edits):
        self._edits = edits

    def find_spec(self, fullname, path=None, target=None):
        """The specification of a bent module; None for any other."""
        if fullname not in self._edits:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None:
            spec.loader = BentLoader(fullname, spec.origin, self._edits[fullname])
        return spec


if (_file := os.environ.get("GAUNTLET_EDITS")) is not None:
    sys.meta_path.insert(0, Bender(json.loads(Path(_file).read_text(encoding="utf-8"))))
