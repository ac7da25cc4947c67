"""Checks of Python, the installed packages and the graphics."""

import importlib.metadata
import os
import platform
import subprocess
import sys

from packaging.requirements import Requirement

from phyagentos.cli.doctor.finding import Finding, Grade

PYTHON_MIN = (3, 11)
RENDER_TIMEOUT_S = 60.0
PACKAGES_OF_DEBIAN = "libegl1 libegl-mesa0 libgl1-mesa-dri"
_RENDER = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><light/></worldbody></mujoco>")
with mujoco.Renderer(model, 32, 32) as renderer:
    renderer.update_scene(mujoco.MjData(model))
    renderer.render()
"""


def check_python() -> Finding:
    """Version and processors."""
    count = len(os.sched_getaffinity(0))
    found = f"Python {platform.python_version()}, {count} processors"
    if sys.version_info < PYTHON_MIN:
        return Finding("python", Grade.BROKEN, found, "Install Python 3.11 or newer.")
    if count < 2:
        return Finding("python", Grade.WEAK, found, "Two processors let the world and the planner work side by side.")
    return Finding("python", Grade.FINE, found)


def check_packages() -> Finding:
    """Every requirement of this project, extras excepted."""
    bad: list[str] = []
    wanted = [Requirement(text) for text in importlib.metadata.requires("phyagentos") or ()]
    core = [each for each in wanted if each.marker is None or each.marker.evaluate({"extra": ""})]
    for requirement in core:
        try:
            version = importlib.metadata.version(requirement.name)
        except importlib.metadata.PackageNotFoundError:
            bad.append(f"{requirement.name} is missing")
            continue
        if not requirement.specifier.contains(version, prereleases=True):
            bad.append(f"{requirement.name} {version}, needs {requirement.specifier}")
    if bad:
        return Finding("packages", Grade.BROKEN, "; ".join(bad), "Install the project again: pip install phyagentos.")
    return Finding("packages", Grade.FINE, f"{len(core)} packages as required")


def check_graphics() -> Finding:
    """Whether a picture can be rendered without a screen, tried in a process of its own."""
    failures = []
    for backend in dict.fromkeys((os.environ.get("MUJOCO_GL", "egl"), "egl", "osmesa")):
        try:
            tried = subprocess.run(
                [sys.executable, "-c", _RENDER],
                env={**os.environ, "MUJOCO_GL": backend},
                capture_output=True,
                text=True,
                timeout=RENDER_TIMEOUT_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            failures.append(f"{backend}: no picture within {RENDER_TIMEOUT_S:.0f} s")
            continue
        if tried.returncode == 0:
            return Finding("graphics", Grade.FINE, f"pictures by {backend}")
        failures.append(f"{backend}: {(tried.stderr.strip().splitlines() or ['no message'])[-1]}")
    fix = f"Runs work without pictures. On Debian: apt-get install {PACKAGES_OF_DEBIAN}."
    return Finding("graphics", Grade.WEAK, "; ".join(failures)[:200], fix)
