"""Robots that are emulated on their vendors' wires; the models are a folder of the user's own."""

import importlib.util
import os
import shutil
from pathlib import Path

import pytest

from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.runtime.targets.driver_registry import DriverSite

HERE = Path(__file__).parent
PROFILES = HERE.parents[1] / "phyagentos" / "runtime" / "drivers" / "devices"
HOW = "PHYAGENTOS_MODELS=<folder with menagerie/> make test-extras"


@pytest.fixture(scope="session")
def menagerie():
    """The folder `menagerie` of the models."""
    found = Path(os.environ.get("PHYAGENTOS_MODELS", "")) / "menagerie"
    if not os.environ.get("PHYAGENTOS_MODELS") or not found.is_dir():
        pytest.skip(f"no models of robots: `{HOW}`")
    return found


@pytest.fixture(scope="session")
def need_package():
    def need(name):
        if importlib.util.find_spec(name) is None:
            pytest.skip(f"no package {name!r}: `{HOW}`")

    return need


@pytest.fixture
def make_site(tmp_path):
    """A target as a user sets it up: the driver's profile, edited, beside the model; opened by its site."""

    def make(name, model=None, **changes):
        library = tmp_path / "library"
        shutil.copytree(HERE / "library", library, dirs_exist_ok=True)
        folder = library / "robots" / name
        folder.mkdir(parents=True)
        if model is not None:
            shutil.copytree(model, folder, dirs_exist_ok=True)
        text = (PROFILES / f"{name}.yaml").read_text()
        for key, value in changes.items():
            old = next(line for line in text.splitlines() if line.strip().startswith(f"{key}:"))
            text = text.replace(old, f"{old.split(':')[0]}: {value}")
        (folder / "target.yaml").write_text(text)
        workspace = Workspace.create(tmp_path / "w", Library.open(library))
        profile = read_target(folder / "target.yaml")
        return DriverSite(profile=profile, folder=folder, workspace=workspace, clock=SystemClock())

    return make
