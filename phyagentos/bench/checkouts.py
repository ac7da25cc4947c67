"""Clones that a user has, as parts of a Python environment: linked by a path file, checked by revision and by files."""

import subprocess
from collections.abc import Iterator
from pathlib import Path

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.capabilities.environments import CheckoutSpec

_LINK = "paos_checkout.pth"


def link_checkout(python: Path, name: str, checkout: CheckoutSpec, folder: Path) -> None:
    """Let an environment import from a clone; raises DefinitionError with all that the clone lacks."""
    if problems := [*_check(name, checkout, folder.resolve())]:
        raise DefinitionError(problems)
    lines = (str(folder.resolve() / path) for path in (".", *checkout.paths))
    _find_link(python).write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def find_checkout_lacks(python: Path, name: str, checkout: CheckoutSpec) -> Iterator[Problem]:
    """What the clone of an environment lacks; one problem where none is linked."""
    link = _find_link(python)
    if not link.is_file():
        hint = f"{_clone(checkout)}, then: paos bench setup {name} --from FOLDER"
        yield Problem("EXTRA_MISSING", name, "no clone", f"a clone of {checkout.url}", hint)
        return
    yield from _check(name, checkout, Path(link.read_text(encoding="utf-8").splitlines()[0]))


def _find_link(python: Path) -> Path:
    folders = sorted(python.parent.parent.glob("lib/python*/site-packages"))
    return next(iter(folders), python.parent) / _LINK


def _clone(checkout: CheckoutSpec) -> str:
    return f"git clone --recurse-submodules {checkout.url} FOLDER"


def _check(name: str, checkout: CheckoutSpec, folder: Path) -> Iterator[Problem]:
    for file in (*checkout.paths, *checkout.files):
        if not (folder / file).exists():
            yield Problem("EXTRA_MISSING", str(folder / file), "no such file", f"{file} of {name}", _clone(checkout))
    for part, wanted in checkout.revisions.items():
        command = ["git", "-C", str(folder / part), "rev-parse", "HEAD"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        found = done.stdout.strip() or "no revision"
        if found != wanted:
            hint = f"git -C {folder / part} checkout {wanted}"
            yield Problem("EXTRA_MISSING", str(folder / part), f"revision {found}", f"revision {wanted}", hint)
