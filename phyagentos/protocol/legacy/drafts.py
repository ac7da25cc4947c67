"""The files of a draft: a target, a skill with its tree, a scene; complete for `paos lint`, useless until completed.

Upstream: `conversion`. What 0.1.x does not say stands empty or at zero, so that nobody takes it for a number of a
datasheet.
"""

from typing import Any

from phyagentos.protocol.store.bodies import render_yaml

PHYSICS_STEP_S = 0.002
_ARM = (
    *("joints", "home_rad", "velocity_rad_s", "acceleration_rad_s2", "jerk_rad_s3", "torque_nm"),
    *("stiffness_nm_rad", "damping_nms_rad"),
)
_GRIPPER = ("max_width_m", "stiffness_n_m", "damping_ns_m", "force_n")
_FAIL = {"code": "NOT_IMPORTED", "message": "this skill was imported without its behaviour"}


def render_target(name: str, kind: str, embodiment: str, period_s: float | None, at: str) -> str:
    """`robots/<name>/target.yaml`.

    Args:
        name: Of the target.
        kind: `simulation`, `real_robot` or `debug`.
        embodiment: As 0.1.x says.
        period_s: Length of one command [s]; None for the default.
        at: Where the entry stands.
    """
    profile: dict[str, Any] = {
        "target": name,
        "description": f"Imported from 0.1.x, to be completed ({embodiment}).",
        "kind": kind,
        "embodiment": embodiment,
        "model": "model.xml",
        **({"control_period_s": period_s} if period_s else {}),
        "arm": {key: [] for key in _ARM},
        "gripper": {"joints": [], "pads": [], **dict.fromkeys(_GRIPPER, 0.0)},
    }
    return (
        f"# Imported from {to_comment(at)}: a draft. What 0.1.x does not say stands empty or at 0: fill in\n"
        "# model, arm and gripper from the datasheet, and the limits in safety.yaml, before it is used.\n"
        + render_yaml(profile)
    )


def render_skill(name: str, kind: str, at: str) -> str:
    """`skills/<name>/SKILL.md`."""
    front = {"skill": name, "description": "Imported from 0.1.x, to be completed.", "kind": kind, "tree": name}
    return (
        f"---\n{render_yaml(front)}---\n# {name}\n\n"
        f"Imported from {to_comment(at)}: a draft. Its tree fails on purpose until it is written. Add parameters,\n"
        "`requires`, `guarantees` and what it `needs` of a target.\n"
    )


def render_tree(name: str, at: str) -> str:
    """`trees/<name>.yaml`: fails at once."""
    tree = {
        "tree": name,
        "description": "A draft: it fails until it is written.",
        "root": {"sequence": {"children": [{"fail": _FAIL}]}},
    }
    return f"# Imported from {to_comment(at)}: a draft.\n{render_yaml(tree)}"


def render_scene(name: str) -> str:
    """`scenes/<name>.yaml`: an empty world."""
    return render_yaml({"scene": name, "description": "A draft: an empty world.", "bodies": {}, "cameras": {}})


def to_comment(text: object) -> str:
    """Text that can stand in a comment: one line, printable."""
    return " ".join("".join(sign if sign.isprintable() else " " for sign in str(text)).split())
