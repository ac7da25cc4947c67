"""The graphics that MuJoCo draws with: it reads their name, MUJOCO_GL, once, while it is imported.

Pictures are drawn off screen by EGL, which needs no display, also beside one; a person may name other graphics. MuJoCo
cannot be imported with graphics that are not here, be it to simulate alone. Rejected: to try what draws before each
run, which takes a second.
"""

import os
import subprocess
import sys

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
    """What a person has named; EGL where that is nothing."""
    return os.environ.get(NAME, "").strip().lower() or ORDINARY


def choose_graphics() -> None:
    """Before this process imports MuJoCo: what a person has named, else EGL, or none where that is not here."""
    if find_named() == ORDINARY:
        os.environ |= make_environment()
        try:
            import mujoco  # noqa: F401
        except Exception:  # the bindings of EGL raise what they like
            os.environ[NAME] = "disable"


def require_graphics() -> None:
    """Refuse what a person has named and cannot draw here, in a second: DefinitionError `INVALID_VALUE`."""
    if find_named() not in NONE | {ORDINARY} and not can_draw():
        hint = f"Unset it: {ORDINARY} is used."
        raise DefinitionError.of("INVALID_VALUE", NAME, explain_unfit(), f"{ORDINARY}, or nothing", hint)


def make_environment() -> dict[str, str]:
    """What a process that draws has in its environment beside that of this one; EGL's bindings take no other name."""
    return {NAME: ORDINARY, PLATFORM: ORDINARY} if find_named() == ORDINARY else {}


def can_draw() -> bool:
    """Whether a process with the environment of a run draws a picture, tried in one."""
    command, environment = [sys.executable, "-c", _TRIAL], os.environ | make_environment()
    try:
        return not subprocess.run(
            command, env=environment, capture_output=True, timeout=TRIAL_S, check=False
        ).returncode
    except subprocess.TimeoutExpired:
        return False


def explain_unfit() -> str:
    """Which graphics cannot draw here, what they need, and the variables that decide it."""
    named = find_named()
    if named not in NEEDS:
        return f"{NAME}={named}, which names no graphics"
    given = [f"{name}={os.environ[name]}" for name in DECIDE if os.environ.get(name, named) != named]
    where = f"here with {', '.join(given)}" if given else "here"
    return f"{NAME}={named}, which needs {NEEDS[named]} and draws nothing {where}"
