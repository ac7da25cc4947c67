"""Gives chosen modules a bent source when they are imported, in every Python process that has this folder on its path.

`tests.mutants.running` names a file of sources in `BENT_SOURCES`. Source is replaced instead of attributes, so that a
name that another module has imported already is bent too; nothing bent is ever written to a cache of byte code.
"""

import json
import os
import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder, SourceFileLoader
from pathlib import Path

SOURCES = json.loads(Path(os.environ["BENT_SOURCES"]).read_text(encoding="utf-8"))


class BentLoader(SourceFileLoader):
    """Compiles the bent source; the cache of byte code is neither read nor written."""

    def get_code(self, fullname):
        """The code of the module."""
        return compile(SOURCES[fullname], self.path, "exec", dont_inherit=True)


class Bender(MetaPathFinder):
    """Finds the modules that are bent; everything else is found as always."""

    def find_spec(self, fullname, path=None, target=None):
        """The specification of a bent module; None for any other."""
        spec = PathFinder.find_spec(fullname, path, target) if fullname in SOURCES else None
        if spec is not None:
            spec.loader = BentLoader(fullname, spec.origin)
        return spec


sys.meta_path.insert(0, Bender())
