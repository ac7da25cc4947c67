"""The gate before a run: what this machine lacks for an episode. Such episodes are *missing*, and say why.

Looked for: Python environments, modules, models of robots, drivers, and policy servers. The environments that suites
declare are made here as well; nothing is installed unasked.
"""

import importlib.util
import json
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path

from packaging.requirements import Requirement

from phyagentos.assembly.drivers import choose_driver
from phyagentos.bench.suite_file import Policy, Variant
from phyagentos.errors import DefinitionError, ExecutionError, Problem
from phyagentos.protocol.capabilities.environments import CheckoutSpec, EnvironmentSpec, find_python
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.runtime.models.sources import require_models

CONNECT_S = 1.0
_LINK = "paos_checkout.pth"  # in an environment: the folders of a clone that it imports from
STDERR = 2  # what pip says is no result
_LOOK = """
import importlib.metadata, importlib.util, json, sys
packages, modules = json.loads(sys.argv[1])
def version(name):
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
def there(name):
    try:
        return importlib.util.find_spec(name) is not None
    except ImportError:
        return False
print(json.dumps([{n: version(n) for n in packages}, [m for m in modules if not there(m)]]))
"""


class Gate:
    """Finds what is lacking; each environment is looked at once."""

    def __init__(self, environments: Mapping[str, EnvironmentSpec]) -> None:
        self._look_at = cache(lambda name: find_lacks(name, environments[name]) if name in environments else [])

    def find_lacks(
        self, variant: Variant, policy: Policy, targets: Sequence[tuple[TargetProfile, Path]]
    ) -> tuple[Problem, ...]:
        """What this machine lacks for the episodes of one cell, whose `targets` stand beside their profiles' files."""
        expected, hint = "a module of this Python", "Install what brings it."
        absent = [module for module in variant.needs if importlib.util.find_spec(module) is None]
        return (
            *_find_policy_lacks(policy),
            *self._look_at(variant.environment),
            *(Problem("EXTRA_MISSING", module, "no such module", expected, hint) for module in absent),
            *(lack for profile, path in targets for lack in _find_target_lacks(profile, path)),
        )


def can_connect(ready: str) -> bool:
    """Whether a server listens at `host:port`."""
    host, _, port = ready.rpartition(":")
    try:
        with socket.create_connection((host, int(port)), CONNECT_S):
            return True
    except OSError:
        return False


def _find_policy_lacks(policy: Policy) -> list[Problem]:
    if policy.serve:
        found = shutil.which(policy.command[0])
        expected, hint = "a program of a policy server", "Install it, or name another one under `serve`."
        return [] if found else [Problem("POLICY_UNREACHABLE", policy.command[0], "no such program", expected, hint)]
    if policy.ready and not can_connect(policy.ready):
        hint = "Start it, or let the suite start it: `serve`."
        return [Problem("POLICY_UNREACHABLE", policy.ready, "no answer", "a policy server that listens", hint)]
    return []


def _find_target_lacks(profile: TargetProfile, path: Path) -> list[Problem]:
    try:
        choose_driver({profile.target: profile}, profile.target)
        if profile.kind == "simulation" and profile.model:
            require_models(profile, path.parent)
    except DefinitionError as error:
        return list(error.problems)
    return []


def find_lacks(name: str, spec: EnvironmentSpec) -> list[Problem]:
    """What an environment lacks of its declaration; empty when it is whole."""
    python, hint = find_python(name), f"Make it: paos bench setup {name}"
    if absent := [file for file in spec.files if not Path(file).exists()]:
        return [Problem("EXTRA_MISSING", file, f"no {file}", "a program's file", spec.about) for file in absent]
    if not spec.packages:
        return []
    if not python.is_file():
        return [Problem("EXTRA_MISSING", str(python), "no such file", f"environment {name!r}", hint)]
    wanted = [Requirement(text) for text in (*spec.packages, *spec.without_dependencies)]
    wanted = [each for each in wanted if each.marker is None or each.marker.evaluate()]
    asked = json.dumps([[each.name for each in wanted], spec.imports])
    done = subprocess.run([python, "-c", _LOOK, asked], capture_output=True, text=True, check=False)
    if done.returncode:
        found = (done.stderr.strip().splitlines() or ["no message"])[-1]
        return [Problem("EXTRA_MISSING", str(python), found, "a Python that starts", hint)]
    versions, absent = json.loads(done.stdout)
    had = [(each, versions[each.name]) for each in wanted]
    unmet = [(each, has) for each, has in had if not (has and each.specifier.contains(has, prereleases=True))]
    lacks = [(f"{each.name} {has or 'not installed'}", str(each)) for each, has in unmet]
    lacks += [(f"no module {module}", f"module {module}") for module in absent]
    clone = find_checkout_lacks(python, name, spec.checkout) if spec.checkout is not None else ()
    return [*(Problem("EXTRA_MISSING", str(python), found, expected, hint) for found, expected in lacks), *clone]


def plan_setup(name: str, spec: EnvironmentSpec, interpreter: str = sys.executable) -> list[list[str]]:
    """The commands that make an environment, in order."""
    python = find_python(name)
    if not spec.packages:
        return []
    folder, pip = python.parent.parent, [str(python), "-m", "pip", "install"]
    commands = [] if python.is_file() else [[interpreter, "-m", "venv", str(folder)]]
    commands.append([*pip, *spec.packages])
    return [*commands, *([[*pip, "--no-deps", *spec.without_dependencies]] if spec.without_dependencies else [])]


def set_up(
    name: str,
    spec: EnvironmentSpec,
    say: Callable[[str], None],
    interpreter: str = sys.executable,
    source: Path | None = None,
) -> Path:
    """Make an environment, or complete it, with a clone at `source`; its interpreter.

    Raises ExecutionError `EXTRA_MISSING` with the command, and DefinitionError with all that the clone lacks.
    """
    for command in plan_setup(name, spec, interpreter):
        say(" ".join(command))
        if code := subprocess.run(command, check=False, stdout=STDERR).returncode:
            raise ExecutionError("EXTRA_MISSING", f"{' '.join(command)!r} ended with code {code}")
    if source is not None and spec.checkout is not None:
        link_checkout(find_python(name), name, spec.checkout, source)
    if lacks := find_lacks(name, spec):
        raise ExecutionError("EXTRA_MISSING", "; ".join(f"{each.found}, wanted {each.expected}" for each in lacks))
    return find_python(name)


def link_checkout(python: Path, name: str, checkout: CheckoutSpec, folder: Path) -> None:
    """Let an environment import from a clone; raises DefinitionError with all that the clone lacks."""
    if problems := [*_check_clone(name, checkout, folder.resolve())]:
        raise DefinitionError(problems)
    lines = (str(folder.resolve() / path) for path in (".", *checkout.paths))
    _find_link(python).write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def find_checkout_lacks(python: Path, name: str, checkout: CheckoutSpec) -> Iterator[Problem]:
    """What the clone of an environment lacks; one problem where none is linked."""
    link = _find_link(python)
    if not link.is_file():
        hint = f"{_clone(checkout)}, then: paos bench setup {name} --from FOLDER"
        yield Problem("EXTRA_MISSING", name, f"no clone ({hint})", f"a clone of {checkout.url}", hint)
        return
    yield from _check_clone(name, checkout, Path(link.read_text(encoding="utf-8").splitlines()[0]))


def _find_link(python: Path) -> Path:
    folders = sorted(python.parent.parent.glob("lib/python*/site-packages"))
    return next(iter(folders), python.parent) / _LINK


def _clone(checkout: CheckoutSpec) -> str:
    return f"git clone --recurse-submodules {checkout.url} FOLDER"


def _check_clone(name: str, checkout: CheckoutSpec, folder: Path) -> Iterator[Problem]:
    for file in (*checkout.paths, *checkout.files):
        if not (folder / file).exists():
            yield Problem("EXTRA_MISSING", str(folder / file), "no such file", f"{file} of {name}", _clone(checkout))
    for part, wanted in checkout.revisions.items():
        command = ["git", "-C", str(folder / part), "log", "-1", "--format=%H"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        found = done.stdout.strip() or "no revision"
        if found != wanted:
            hint = f"git -C {folder / part} checkout {wanted}"
            yield Problem("EXTRA_MISSING", str(folder / part), f"revision {found}", f"revision {wanted}", hint)
