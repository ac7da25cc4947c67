"""A first draft of a profile from any MJCF, URDF or xacro: what the model says, and guesses that are marked `check`."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import yaml

from phyagentos.errors import DefinitionError, Problem, format_names
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.targets import FINGERTIP_CLEAR_M, Gripper
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.models.compiling import compile_model
from phyagentos.runtime.models.hand_drafting import (
    HINGE,
    PAD_M,
    SLIDE,
    HandDraft,
    Placed,
    draft_hand,
    find_flange,
    is_below,
)
from phyagentos.runtime.models.robot import read_model, read_profile

_JAW = re.compile("jaw|finger|grip|camera", re.IGNORECASE)
_PLAIN = re.compile(r"(?!(?:y|n|yes|no|on|off|true|false|null)$)[A-Za-z_][\w.-]*(?:/[\w.-]+)*", re.IGNORECASE)
_PATH = re.compile(r"[\w:./+@-]+")
GUESSED_TORQUE_NM, GUESSED_SPEED_RAD_S, GUESSED_LOAD_KG, GUESSED_GRIP_N = 20.0, 1.0, 1.0, 20.0
STIFFNESS_PER_TORQUE, DAMPING_SHARE = 40.0, 0.1  # of a servo that holds its arm within a few milliradians
ARMATURE_S2 = 0.001  # least inertia of motors behind gears, of their torque; with less such a servo shakes light links
ENDLESS_RAD = 8.0 * np.pi  # of a range of an arm's joint: as wide ones have no end
SQUEEZE_M, GRIP_DAMPING_S = 0.01, 0.03  # of a drive of a gripper: at which it has its full force; of its stiffness
UNMOVED = Pose((0.0, 0.0, 0.0))
ARM, LEG = 4, 3  # hinges after which what branches is a hand; that make one of several arms


@dataclass(frozen=True, slots=True)
class CarriedHand:
    """A hand that profiles carry already: its model, their lines for `tool` and `gripper`, and its mass [kg]."""

    model: str
    tool: str
    gripper: str
    mass_kg: float


@dataclass(frozen=True, slots=True)
class ProfileDraft:
    """What a model says of a robot, and what was guessed.

    Attributes:
        model: As the profile names it; `compiled` is the same, all its joints there.
        chain: Joints of the arm in `compiled`.
        parked: Where the joints of other branches stand still [rad or m].
        fingers: Likewise those beyond the arm, where it has no hand that is drafted.
        speeds: That the file gives, by joint [rad/s].
        forces: Likewise the largest ones of its motors [N m or N].
        home_rad: One for each joint of the chain.
        band_m: Least and greatest distance from the base at which an object can be taken.
        width_m: Opening of the hand.
        depth_m: How far what it takes may reach above the tool centre point.
        mount: Where its base stands.
        carried: A hand of another model, at the end of the last link.
        on_model: Remarks on the model, for people.
    """

    name: str
    file: str
    model: str
    arguments: Mapping[str, str]
    compiled: mujoco.MjModel
    chain: Sequence[int]
    parked: dict[str, float]
    fingers: dict[str, float]
    speeds: Mapping[str, float]
    forces: Mapping[str, float]
    hand: HandDraft | None
    home_rad: Sequence[float]
    on_model: tuple[str, ...]
    band_m: tuple[float, float] = (0.3, 0.6)
    width_m: float = 0.002
    depth_m: float = 0.005
    mount: Pose = UNMOVED
    carried: CarriedHand | None = None

    @property
    def remarks(self) -> tuple[str, ...]:
        """On the model and the hand, for people."""
        if self.hand is None or not self.hand.still:
            return self.on_model
        return *self.on_model, f"of its fingers {format_names(self.hand.joints)} close; the others stand still"

    def render(self) -> str:
        """YAML of the profile."""
        model, chain, hand = self.compiled, self.chain, self.hand
        limits = [self._find_force(model.joint(joint).name) for joint in chain]
        armature_kg_m2 = model.dof_armature[model.jnt_dofadr[list(chain)]].tolist()
        torque = [limit if limit > 0.0 else GUESSED_TORQUE_NM for limit in limits]
        least_kg_m2 = ARMATURE_S2 * min(torque)
        names = [model.joint(joint).name for joint in chain]
        speeds = [self.speeds.get(name, 0.0) or GUESSED_SPEED_RAD_S for name in names]
        is_known = all(self.speeds.get(name) for name in names)
        endless = {_quote(name): "[-3.14, 3.14]" for name, joint in zip(names, chain, strict=True)
                   if not 0.0 < np.ptp(model.jnt_range[joint]) < ENDLESS_RAD}  # fmt: skip
        parked = {
            _quote(name): f"{at:.6g}"
            for name, at in (self.parked | (self.fingers if hand is None else hand.still)).items()
        }
        opens, load_kg, tool, gripper = self._list_end()
        sheet, found = "# check: its data sheet", "# of the model"
        lines = [
            f"# Drafted from {self.file}; check every line that says check, then: paos robot check {self.name}",
            f"target: {self.name}",
            f"description: {self.name}, simulated with contact physics.",
            f"model: {self.model if _PATH.fullmatch(self.model) else json.dumps(self.model)}",
            f"arguments: {json.dumps(dict(self.arguments))}" if self.arguments else "",
            *tool,
            *(_list_mount(self.mount) if self.mount != UNMOVED else ()),
            f"grasp_band_m: {_show(self.band_m)}   # check: paos robot try {self.name} measures it",
            _map("ranges", endless, "the model lets them turn without end"),
            _map("parked_rad", parked, "joints of the model that this target does not move"),
            "arm:",
            f"  joints: [{', '.join(map(_quote, names))}]",
            f"  home_rad: {_show(self.home_rad)}   # check: a posture in front of its work",
            f"  velocity_rad_s: {_show(speeds)}   {found if is_known else sheet}",
            f"  acceleration_rad_s2: {_show([10.0] * len(chain))}   {sheet}",
            f"  jerk_rad_s3: {_show([5000.0] * len(chain))}",
            f"  torque_nm: {_show(torque)}   {found if all(limits) else sheet}",
            f"  stiffness_nm_rad: {_show([STIFFNESS_PER_TORQUE * each for each in torque])}",
            f"  damping_nms_rad: {_show([STIFFNESS_PER_TORQUE * DAMPING_SHARE * each for each in torque])}",
            ""
            if min(armature_kg_m2) >= least_kg_m2
            else f"  armature_kg_m2: {max(*armature_kg_m2, least_kg_m2):.4g}   {sheet}, of motors and gears",
            f"  payload_kg: {load_kg:.4g}   {sheet}, the hand included",
            f"  wrist_joints: {min(3, len(chain))}",
            *gripper,
            f"observations: [joint_state{opens}, entity_poses, camera_rgb]",
            f"actions: [joint_position{opens}]",
            "capabilities: [manipulation]",
        ]
        return "\n".join(filter(None, lines)) + "\n"

    def _list_end(self) -> tuple[str, float, list[str], list[str]]:
        """What opens, the load [kg], and the lines of the tool and of the gripper."""
        model, hand, carried = self.compiled, self.hand, self.carried
        body = model.body(int(model.jnt_bodyid[self.chain[-1]])).name
        if carried is not None:
            at = f"{{body: {_quote(body)}, {_place(find_flange(model, self.chain))}}}"
            tool = [f"hand: {{model: '{carried.model}', at: {at}}}   # check: its base", carried.tool]
            return ", gripper_width", GUESSED_LOAD_KG + carried.mass_kg, tool, [carried.gripper]
        at = "" if hand is None else f", {_place(hand.tool)}"
        hint = "# check: z approaches, y is the closing axis; see paos robot render"
        tool = [f"tool: {{body: {_quote(body)}{at}}}   {hint}"]
        if hand is None:
            why = f"no two sides of {format_names(self.fingers)} close: write `gripper`, or " if self.fingers else ""
            asks = f"end_effector: none   # check: {why}draft it anew with --hand menagerie:robotiq_2f85/2f85.xml"
            return "", GUESSED_LOAD_KG, tool, [asks]
        return (
            ", gripper_width",
            GUESSED_LOAD_KG,
            tool,
            _list_gripper(hand, self.width_m, self.depth_m, self._find_grip(hand), self._measure_inertia(hand)),
        )

    def _find_force(self, joint: str) -> float:
        """The largest one of a joint [N m or N]; zero where the model does not say it."""
        force = float(np.abs(self.compiled.jnt_actfrcrange[self.compiled.joint(joint).id]).max())
        return force or self.forces.get(joint, 0.0)

    def _find_grip(self, hand: HandDraft) -> float:
        """Of the drive [N]: a guess, no more than any of its joints has; and what the dry friction of all takes."""
        forces = [self._find_force(name) / abs(share) for name, share in zip(hand.joints, hand.travel, strict=True)]
        friction = self.compiled.dof_frictionloss[self._find_moved(hand)]
        return min([GUESSED_GRIP_N, *filter(None, forces)]) + float(friction.sum()) / sum(map(abs, hand.travel))

    def _measure_inertia(self, hand: HandDraft) -> float:
        """Of the fingers and what moves with them, against the drive [kg]."""
        return float(self.compiled.dof_M0[self._find_moved(hand)].sum()) / sum(map(abs, hand.travel)) ** 2

    def _find_moved(self, hand: HandDraft) -> list[int]:
        """Degrees of freedom that move as the hand closes."""
        model, top = self.compiled, int(self.compiled.jnt_bodyid[self.chain[-1]])
        return [
            int(model.jnt_dofadr[k])
            for k in range(model.njnt)
            if k not in self.chain and is_below(model, int(model.jnt_bodyid[k]), top)
            and model.joint(k).name not in hand.still
        ]  # fmt: skip


def _list_mount(mount: Pose) -> list[str]:
    high = "true   # a column" if mount.position_m[2] else "false"
    return [
        f"mount_position_m: {_show(mount.position_m)}   # check: it reaches what is in front so, along x",
        f"mount_quaternion_wxyz: {_show(mount.quaternion_wxyz)}",
        f"stands_on_column: {high}",
    ]


def _list_gripper(hand: HandDraft, width_m: float, depth_m: float, force_n: float, inertia_kg: float) -> list[str]:
    stiffness_n_m = max(GUESSED_GRIP_N, force_n) / SQUEEZE_M
    speed_m_s = np.sqrt(GUESSED_GRIP_N * SQUEEZE_M / inertia_kg)  # as they start, they lag half as far as in a grip
    is_slow = speed_m_s < Gripper.model_fields["speed_m_s"].default
    pads = [
        f"    - {{name: pad_{index}, body: {_quote(body)}, {_place(pose)}, half_m: {_show(PAD_M)}}}"
        for index, (body, pose) in enumerate(hand.pads)
    ]
    return [
        "gripper:",
        f"  joints: [{', '.join(map(_quote, hand.joints))}]",
        f"  travel: {_show(hand.travel)}   # share of each joint in the drive, metres of opening a unit",
        "  pads: [pad_0, pad_1]",
        "  pad_boxes:   # check: where each finger grips",
        *pads,
        "  pad_surface: rubber",
        f"  max_width_m: {width_m:.4g}   # as the pads open in the model",
        f"  stiffness_n_m: {stiffness_n_m:.4g}",
        f"  damping_ns_m: {GRIP_DAMPING_S * stiffness_n_m:.4g}",
        f"  force_n: {force_n:.3g}   # check: its data sheet",
        *(
            [f"  speed_m_s: {speed_m_s:.2g}   # check: its data sheet; the model's joints are as heavy"]
            if is_slow
            else []
        ),
        f"  palm_depth_m: {depth_m:.3g}   # beyond it something else than the pads would touch",
        f"  palm_height_m: {max(hand.palm_m + hand.tip_m, 0.01):.3g}",
        f"  fingertip_m: {hand.tip_m + FINGERTIP_CLEAR_M:.3g}",
    ]


def _map(key: str, values: Mapping[str, str], why: str) -> str:
    inside = ", ".join(f"{name}: {value}" for name, value in values.items())
    return f"{key}: {{{inside}}}   # check: {why}" if values else ""


def find_carried(model: str, library: Library) -> CarriedHand:
    """A hand as the first profile that carries it describes it; raises DefinitionError `UNKNOWN_NAME`."""
    profiles = [read_profile(library.get_target(name))[0] for name in library.names_of_targets()]
    known = {profile.hand.model: profile for profile in reversed(profiles) if profile.hand is not None}
    if model not in known:
        raise DefinitionError.unknown("hand", "--hand", model, known)
    parts = known[model].model_dump(mode="json", include={"tool", "gripper"}, exclude_defaults=True)
    tool, gripper = (
        yaml.safe_dump({key: parts[key]}, default_flow_style=None, sort_keys=False, width=1000).rstrip()
        for key in ("tool", "gripper")
    )
    return CarriedHand(model, tool, gripper, known[model].gripper.mass_kg)


def draft_profile(
    path: Path,
    model: str,
    name: str,
    arguments: Mapping[str, str] = {},
    joint: str = "",
    hand: CarriedHand | None = None,
) -> ProfileDraft:
    """Draft the profile of a model file, which it names `model`; of several arms that with a `joint`.

    `hand` is one that its end carries.

    Raises:
        DefinitionError: `MODEL_INVALID` where no hinges follow each other, `UNKNOWN_NAME` for the joint; as of
            `read_model` and `compile_model`.
    """
    source = read_model(path, arguments)
    compiled = compile_model(source.spec, path)
    names = [compiled.joint(index).name for index in range(compiled.njnt)]
    if joint and joint not in names:
        raise DefinitionError([Problem.unknown("joint", str(path), joint, names)])
    chain, others = _find_chain(compiled, names.index(joint) if joint else -1)
    if not chain or (others and len(chain) < LEG):
        raise _refuse_without_arm(path, names)
    last = int(compiled.jnt_bodyid[chain[-1]])
    bodies = compiled.jnt_bodyid.tolist()
    below = [index for index, body in enumerate(bodies) if index not in chain and is_below(compiled, body, last)]
    moving = [index for index in range(compiled.njnt) if int(compiled.jnt_type[index]) in {HINGE, SLIDE}]
    gripper = draft_hand(compiled, last, below) if hand is None else None
    fixed = _find_fixed(compiled, last) if hand is not None else []
    parked = {names[index]: _find_middle(compiled, index, 0.0) for index in sorted(set(moving) - {*chain, *below})}
    fingers = {names[index]: _find_middle(compiled, index, 0.0) for index in below}
    free = [compiled.body(int(compiled.jnt_bodyid[k])).name for k in range(compiled.njnt) if k not in moving]
    remarks = [*source.remarks, *(f"body {name!r} floats in the model: it stands still here" for name in free)]
    if others:
        ends = ", ".join(names[other[-1]] for other in others)
        remarks.append(f"{len(others) + 1} arms of {len(chain)} hinges: drafted is that of {names[chain[-1]]}; "
                       f"another with --joint: {ends}")  # fmt: skip
    if fixed:
        remarks.append(f"the hand stands beyond {format_names(fixed)}, fixed to the last link: "
                       "take out of a copy of the model what the hand replaces")  # fmt: skip
    home_rad = [_find_middle(compiled, index) for index in chain]
    return ProfileDraft(
        name, path.name, model, arguments, compiled, chain, parked, fingers, source.speeds, source.forces, gripper,
        home_rad, tuple(remarks), carried=hand,
    )  # fmt: skip


def _refuse_without_arm(path: Path, joints: list[str]) -> DefinitionError:
    found, hint = "no joint", "Of parts or macros give the file that puts them together."
    if joints:
        found = f"no arm among its joints {format_names(joints)}"
        hint = "A gripper alone is the `hand` of an arm's profile; docs/robots.md says more of hands and bases."
    return DefinitionError.of("MODEL_INVALID", str(path), found, "an arm: hinges, one after another", hint)


def _find_fixed(model: mujoco.MjModel, last: int) -> list[str]:
    """Links with a form of their own that are fixed to the last one of an arm."""
    held = set(model.geom_bodyid[model.body_weldid[model.geom_bodyid] == model.body_weldid[last]].tolist())
    return [model.body(body).name for body in sorted(held - {last})]


def _find_middle(model: mujoco.MjModel, joint: int, wanted: float | None = None) -> float:
    low, high = map(float, model.jnt_range[joint])
    return (low + high) / 2 if wanted is None or low > high else min(max(wanted, low), high)


def _find_chain(model: mujoco.MjModel, wanted: int) -> tuple[list[int], list[list[int]]]:
    """The joints of an arm, with `wanted` among them if there is one; and those of arms as long beside it."""

    def follow(body: int, above: int) -> list[list[int]]:
        """Runs of hinges from a body on, the best first."""
        joints = range(int(model.body_jntadr[body]), int(model.body_jntadr[body]) + int(model.body_jntnum[body]))
        own = [joint for joint in joints if model.jnt_type[joint] == HINGE]
        if above and len(own) < len(joints):
            return []  # fingers that slide
        children = [child for child in range(1, model.nbody) if model.body_parentid[child] == body]
        branches = [runs for child in children if any(runs := follow(child, above + len(own)))]
        if len(branches) > 1 and above + len(own) >= ARM:
            return [own]  # a hand of several fingers
        return [own + run for runs in branches for run in runs] or [own]

    def rank(run: list[int]) -> tuple[bool, int, list[int]]:
        return wanted not in run, -len(run), run

    roots = [body for body in range(1, model.nbody) if model.body_parentid[body] == 0]
    found = [run for body in roots for run in follow(body, 0)]
    runs = sorted((_drop_jaws(model, run) for run in found), key=rank) or [[]]
    return runs[0], [run for run in runs[1:] if len(run) == len(runs[0]) and run != runs[0]]


def _drop_jaws(model: mujoco.MjModel, run: list[int]) -> list[int]:
    end = int(model.jnt_bodyid[run[-1]]) if run else 0
    if any(is_below(model, body, end) for joint, body in enumerate(model.jnt_bodyid.tolist()) if joint not in run):
        return run  # what carries fingers is none
    while run and _JAW.search(model.joint(run[-1]).name):
        run = run[:-1]
    return run


def _quote(name: str) -> str:
    """A name as YAML has it."""
    return name if _PLAIN.fullmatch(name) else json.dumps(name)


def _place(placed: Placed) -> str:
    return f"position_m: {_show(placed[0].tolist())}, quaternion_wxyz: {_show(placed[1])}"


def _show(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{round(float(value), 6) + 0.0:.6g}' for value in values)}]"
