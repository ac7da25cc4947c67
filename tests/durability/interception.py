"""Standing between the store and the operating system: every call that changes the disk below one folder.

It replaces functions of `os`, so that code beside `SystemIO` is seen too. What goes past `os` as well (a plain
`file.write`) shows itself: the recorded calls then do not add up to the folder as it is.
"""

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

_BY_DESCRIPTOR = ("write", "pwrite", "ftruncate", "fsync", "fdatasync", "pread")
_BY_PATH = ("replace", "rename", "link", "unlink", "remove", "mkdir", "rmdir")
_hooked: list["Calls"] = []


class Calls:
    """Lets every call through; a subclass records it, or lets it fail.

    Args:
        root: Calls on anything else are none of its business.
    """

    def __init__(self, root: Path) -> None:
        self.root = str(root)

    def by_descriptor(self, name: str, real: Callable, path: str, fd: int, *args: Any) -> Any:
        """`write`, `pwrite`, `ftruncate`, `fsync`, `fdatasync`, `pread` of the file or folder at `path`."""
        return real(fd, *args)

    def by_path(self, name: str, real: Callable, *paths: str) -> Any:
        """`replace`, `rename`, `link`, `unlink`, `remove`, `mkdir`, `rmdir`."""
        return real(*paths)

    def on_open(self, path: str, flags: int) -> None:
        """Called before a file is opened that may be created or emptied by it."""

    def owns(self, path: str) -> bool:
        is_below = path == self.root or path.startswith(self.root + os.sep)
        return is_below and not path.startswith(f"{self.root}/.cache/")


def find_path(fd: int) -> str:
    try:
        return str(Path(f"/proc/self/fd/{fd}").readlink())
    except OSError:
        return ""


@contextlib.contextmanager
def intercept(calls: Calls) -> Iterator[Calls]:
    """Route the calls through `calls` while the block runs."""
    real = {name: getattr(os, name) for name in (*_BY_DESCRIPTOR, *_BY_PATH)}

    def wrap_descriptor(name: str) -> Callable:
        def called(fd: int, *args: Any) -> Any:
            path = find_path(fd)
            return calls.by_descriptor(name, real[name], path, fd, *args) if calls.owns(path) else real[name](fd, *args)

        return called

    def wrap_path(name: str) -> Callable:
        def called(*paths: Any, **options: Any) -> Any:
            names = [os.fspath(path) for path in paths if not isinstance(path, int)]
            if not calls.owns(names[0]) or any(value is not None for key, value in options.items() if "dir_fd" in key):
                return real[name](*paths, **options)
            return calls.by_path(name, lambda *_: real[name](*paths, **options), *names)

        return called

    if not _hooked:
        sys.addaudithook(_hear)
    _hooked.append(calls)
    for name in _BY_DESCRIPTOR:
        setattr(os, name, wrap_descriptor(name))
    for name in _BY_PATH:
        setattr(os, name, wrap_path(name))
    try:
        yield calls
    finally:
        for name, function in real.items():
            setattr(os, name, function)
        _hooked[-1] = Calls(Path("/nowhere"))  # the hook itself cannot be taken away


def _hear(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and _hooked:
        path, _, flags = arguments
        if isinstance(path, str | os.PathLike) and flags & (os.O_CREAT | os.O_TRUNC):
            path = os.fspath(path)
            if isinstance(path, str) and _hooked[-1].owns(path):
                _hooked[-1].on_open(path, flags)
