"""Imports of libraries that load matplotlib for plots of their own, which takes longer than all else that they load."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType


@contextmanager
def without_plots() -> Iterator[None]:
    """Within it, what is imported finds an empty matplotlib, unless the real one is loaded; after it, the real one."""
    empty = {name: ModuleType(name) for name in ("matplotlib", "matplotlib.pyplot") if name not in sys.modules}
    sys.modules.update(empty)
    try:
        yield
    finally:
        for name in empty:
            del sys.modules[name]
