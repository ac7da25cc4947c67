"""Makes the Python environments that suites declare, and says what one lacks. Nothing is installed unasked."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from packaging.requirements import Requirement

from phyagentos.errors import ExecutionError, Problem
from phyagentos.protocol.capabilities.environments import EnvironmentSpec, find_python

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


def find_lacks(name: str, spec: EnvironmentSpec) -> list[Problem]:
    """What an environment lacks of its declaration; empty when it is whole."""
    python, hint = find_python(name), f"Make it: paos bench setup {name}"
    if not python.is_file():
        return [Problem("ENVIRONMENT_MISSING", str(python), "no such file", f"environment {name!r}", hint)]
    wanted = [Requirement(text) for text in (*spec.packages, *spec.without_dependencies)]
    wanted = [each for each in wanted if each.marker is None or each.marker.evaluate()]
    asked = json.dumps([[each.name for each in wanted], spec.imports])
    done = subprocess.run([python, "-c", _LOOK, asked], capture_output=True, text=True, check=False)
    if done.returncode:
        found = (done.stderr.strip().splitlines() or ["no message"])[-1]
        return [Problem("ENVIRONMENT_MISSING", str(python), found, "a Python that starts", hint)]
    versions, absent = json.loads(done.stdout)
    unmet = [each for each in wanted if not _is_met(each, versions[each.name])]
    lacks = [(f"{each.name} {versions[each.name] or 'not installed'}", str(each)) for each in unmet]
    lacks += [(f"no module {module}", f"module {module}") for module in absent]
    return [Problem("ENVIRONMENT_MISSING", str(python), found, expected, hint) for found, expected in lacks]


def _is_met(requirement: Requirement, version: str | None) -> bool:
    return version is not None and requirement.specifier.contains(version, prereleases=True)


def plan_setup(name: str, spec: EnvironmentSpec, interpreter: str = sys.executable) -> list[list[str]]:
    """The commands that make an environment, in order."""
    python = find_python(name)
    folder, pip = python.parent.parent, [str(python), "-m", "pip", "install"]
    commands = [] if python.is_file() else [[interpreter, "-m", "venv", str(folder)]]
    commands.append([*pip, *spec.packages])
    return [*commands, *([[*pip, "--no-deps", *spec.without_dependencies]] if spec.without_dependencies else [])]


def set_up(name: str, spec: EnvironmentSpec, say: Callable[[str], None], interpreter: str = sys.executable) -> Path:
    """Make an environment, or complete it; its interpreter.

    Raises:
        ExecutionError: `SETUP_FAILED`, with the command; what pip printed stands above it.
    """
    for command in plan_setup(name, spec, interpreter):
        say(" ".join(command))
        if code := subprocess.run(command, check=False, stdout=STDERR).returncode:
            raise ExecutionError("SETUP_FAILED", f"{' '.join(command)!r} ended with code {code}")
    if lacks := find_lacks(name, spec):
        raise ExecutionError("SETUP_FAILED", "; ".join(f"{each.found}, wanted {each.expected}" for each in lacks))
    return find_python(name)
