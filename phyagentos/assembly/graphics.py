"""The graphics that MuJoCo draws with: it reads their name, MUJOCO_GL, once, while it is imported.

Pictures are drawn off screen by EGL, which needs no display, also beside one; a person may name other graphics. MuJoCo
cannot be imported with graphics that are not here, be it to simulate alone. Rejected: to try what draws before each
run, which takes a second.
"""

import ctypes
import os
import subprocess
import sys
from collections.abc import MutableMapping

from phyagentos.errors import DefinitionError

NAME, PLATFORM, ORDINARY = "MUJOCO_GL", "PYOPENGL_PLATFORM", "egl"
NONE = frozenset({"disable", "disabled", "off", "false", "0"})  # names by which MuJoCo draws nothing
NEEDS = {
    "egl": "libEGL and a device that it drives",
    "osmesa": "libOSMesa",
    **dict.fromkeys(("glfw", "glx", "enable", "enabled", "on", "true", "1"), "a display"),
}
DECIDE = (PLATFORM, "DISPLAY", "MUJOCO_EGL_DEVICE_ID")  # they decide, too, whether anything is drawn
TRIAL_S = 60.0
_TRIAL = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><light/></worldbody></mujoco>")
with mujoco.Renderer(model, 32, 32) as renderer:
    renderer.update_scene(mujoco.MjData(model))
    renderer.render()
"""


def find_named() -> str:
    """What a person has named; empty for nothing."""
    return os.environ.get(NAME, "").strip().lower()


def choose_graphics() -> None:
    """Before this process imports MuJoCo: what a person has named, else EGL, or none where that is not here."""
    if find_named():
        return
    _name_ordinary(os.environ)
    try:
        import mujoco  # noqa: F401
    except Exception:  # the bindings of EGL raise what they like
        os.environ[NAME] = "disable"


def require_graphics() -> None:
    """Refuse what a person has named and cannot draw here, in a second: DefinitionError `INVALID_VALUE`."""
    named = find_named()
    is_ordinary = named == ORDINARY and os.environ.get(PLATFORM, ORDINARY) == ORDINARY and _has_egl()
    if not named or named in NONE or is_ordinary or can_draw():
        return
    raise DefinitionError.of(
        "INVALID_VALUE", NAME, explain_unfit(), "egl, or nothing", f"Unset it: {ORDINARY} is used."
    )


def can_draw() -> bool:
    """Whether a process with the environment of a run draws a picture, tried in one."""
    environment = dict(os.environ)
    if not find_named():
        _name_ordinary(environment)
    command = [sys.executable, "-c", _TRIAL]
    try:
        return not subprocess.run(
            command, env=environment, capture_output=True, timeout=TRIAL_S, check=False
        ).returncode
    except subprocess.TimeoutExpired:
        return False


def explain_unfit() -> str:
    """Which graphics cannot draw here, what they need, and the variables that decide it."""
    named = find_named() or ORDINARY
    if named not in NEEDS:
        return f"{NAME}={named}, which names no graphics"
    given = [f"{name}={os.environ[name]}" for name in DECIDE if os.environ.get(name)]
    where = f"here with {', '.join(given)}" if given else "here"
    return f"{NAME}={named}, which needs {NEEDS[named]} and draws nothing {where}"


def _name_ordinary(environment: MutableMapping[str, str]) -> None:
    environment[NAME] = ORDINARY
    environment.pop(PLATFORM, None)


def _has_egl() -> bool:
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError:
        return False
    return True
