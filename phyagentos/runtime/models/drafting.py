"""A first draft of a profile from any MJCF or URDF: what the model says, and guesses that are marked `check`."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from phyagentos.errors import DefinitionError
from phyagentos.runtime.models.compiling import compile_model
from phyagentos.runtime.models.robot import read_model

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_JAW = re.compile("jaw|finger|grip", re.IGNORECASE)
GUESSED_TORQUE_NM, GUESSED_SPEED_RAD_S = 20.0, 1.0
STIFFNESS_PER_TORQUE, DAMPING_SHARE = 40.0, 0.1  # of a servo that holds its arm within a few milliradians


def draft_profile(path: Path, model: str, name: str, arguments: Mapping[str, str] = {}) -> tuple[str, tuple[str, ...]]:
    """YAML of a profile for a model file, and remarks on that; `model` is how the profile names it.

    Raises:
        DefinitionError: `MODEL_INVALID` where no hinge is found.
    """
    source = read_model(path, arguments)
    compiled = compile_model(source.spec, path)
    chain = _find_chain(compiled)
    if not chain:
        raise DefinitionError.of("MODEL_INVALID", str(path), "no hinge", "an arm of hinges")
    last = int(compiled.jnt_bodyid[chain[-1]])
    fingers = [joint for joint in range(compiled.njnt) if joint not in chain and _is_below(compiled, joint, last)]
    limits = [float(np.abs(compiled.jnt_actfrcrange[joint]).max()) for joint in chain]
    torque = [limit if limit > 0.0 else GUESSED_TORQUE_NM for limit in limits]
    home = [float(compiled.jnt_range[joint].mean()) for joint in chain]  # zero where a joint turns without end
    names = [compiled.joint(joint).name for joint in chain]
    lines = [
        f"# Drafted from {path.name}; check every line that says check, then: paos robot check {name}",
        f"target: {name}",
        f"description: {name}, simulated with contact physics.",
        f"model: {model}",
        *([f"arguments: {json.dumps(dict(arguments))}"] if arguments else []),
        *_draft_tool(compiled, last, fingers),
        "grasp_band_m: [0.3, 0.6]   # check: distances from the base between which objects can be taken from above",
        "arm:",
        f"  joints: [{', '.join(names)}]",
        f"  home_rad: {_show(home)}   # check: a posture in front of its work",
        f"  velocity_rad_s: {_show([GUESSED_SPEED_RAD_S] * len(chain))}   # check: its data sheet",
        f"  acceleration_rad_s2: {_show([10.0] * len(chain))}",
        f"  jerk_rad_s3: {_show([5000.0] * len(chain))}",
        f"  torque_nm: {_show(torque)}",
        f"  stiffness_nm_rad: {_show([STIFFNESS_PER_TORQUE * each for each in torque])}",
        f"  damping_nms_rad: {_show([STIFFNESS_PER_TORQUE * DAMPING_SHARE * each for each in torque])}",
        "  payload_kg: 1.0   # check: its data sheet, the hand included",
        *_draft_gripper(compiled, fingers),
        "observations: [joint_state, gripper_width, entity_poses, camera_rgb]",
        "actions: [joint_position, gripper_width]",
        "capabilities: [manipulation]",
    ]
    return "\n".join(lines) + "\n", source.remarks


def _find_chain(model: mujoco.MjModel) -> list[int]:
    """The longest run of joints from a root on, before the tree branches into two that move, or into slides."""
    joints_of = {body: range(int(model.body_jntadr[body]), int(model.body_jntadr[body] + model.body_jntnum[body]))
                 for body in range(model.nbody)}  # fmt: skip

    def follow(body: int) -> list[int]:
        own = [joint for joint in joints_of[body] if model.jnt_type[joint] == HINGE]
        if len(own) < len(joints_of[body]):
            return []
        children = [child for child in range(1, model.nbody) if model.body_parentid[child] == body and child != body]
        ways = [way for child in children if (way := follow(child))]
        return own + (ways[0] if len(ways) == 1 else [])

    roots = [body for body in range(1, model.nbody) if model.body_parentid[body] == 0]
    chain = max(map(follow, roots), key=len, default=[])
    while chain and _JAW.search(model.joint(chain[-1]).name):
        chain = chain[:-1]
    return chain


def _is_below(model: mujoco.MjModel, joint: int, body: int) -> bool:
    at = int(model.jnt_bodyid[joint])
    while at not in {0, body}:
        at = int(model.body_parentid[at])
    return at == body and body != 0


def _draft_tool(model: mujoco.MjModel, body: int, fingers: Sequence[int]) -> list[str]:
    """Between the ends of the fingers, else at the origin of the last link."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    moved = sorted({int(model.jnt_bodyid[joint]) for joint in fingers})
    place = data.xpos[moved].mean(axis=0) if moved else data.xpos[body]
    local = data.xmat[body].reshape(3, 3).T @ (place - data.xpos[body])
    hint = "   # check: z approaches, y is the closing axis; see `paos robot render`"
    return [f"tool: {{body: {model.body(body).name}, position_m: {_show(local.tolist())}}}{hint}"]


def _draft_gripper(model: mujoco.MjModel, fingers: Sequence[int]) -> list[str]:
    if not fingers:
        return ["end_effector: none   # check: or a hand: {model: menagerie:robotiq_2f85/2f85.xml, at: {body: ...}}"]
    slides = [joint for joint in fingers if model.jnt_type[joint] == SLIDE]
    chosen = (slides or list(fingers))[:2]
    names = [model.joint(joint).name for joint in chosen]
    bodies = [model.body(int(model.jnt_bodyid[joint])).name for joint in chosen]
    span = float(sum(np.ptp(model.jnt_range[joint]) for joint in chosen))
    signs = [1.0 if abs(model.jnt_range[joint][1]) >= abs(model.jnt_range[joint][0]) else -1.0 for joint in chosen]
    travel = signs if slides else [0.05 * sign for sign in signs]  # metres of opening a radian
    pads = [
        f"    - {{name: pad_{index}, body: {body}, half_m: [0.01, 0.004, 0.01]}}" for index, body in enumerate(bodies)
    ]
    return [
        "gripper:",
        f"  joints: [{', '.join(names)}]",
        f"  travel: {_show(travel)}   # check: share of each joint in the drive, metres of opening a unit",
        f"  pads: [{', '.join(f'pad_{index}' for index in range(len(bodies)))}]",
        "  pad_boxes:   # check: where each finger grips",
        *pads,
        "  pad_surface: rubber",
        f"  max_width_m: {span if slides else 0.08:.4g}   # check: its data sheet; `paos robot check` measures it",
        "  stiffness_n_m: 2000.0",
        "  damping_ns_m: 60.0",
        "  force_n: 20.0   # check: its data sheet",
    ]


def _show(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{value:.6g}' for value in values)}]"
