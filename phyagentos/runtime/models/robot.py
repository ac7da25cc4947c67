"""From a target profile to the robot's part of a MuJoCo model: file, mount, servos.

The robot's own spec is the root to which a scene adds its bodies, so that its names stay as the file gives them.
Alternative rejected: `MjSpec.attach`, which needs a prefix on every name.
"""

import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from phyagentos.errors import DefinitionError, Problem, format_hint
from phyagentos.geometry import compute_rotation
from phyagentos.protocol.capabilities.targets import HAND, Frame, TargetProfile, is_beside
from phyagentos.protocol.documents.enclosure import leads_out
from phyagentos.protocol.documents.schema import Address, read_yaml, validate
from phyagentos.runtime.models.base import free_base, freeze, put_on_plane
from phyagentos.runtime.models.compiling import compile_model, explain
from phyagentos.runtime.models.meshes import settle_meshes
from phyagentos.runtime.models.sources import find_model, find_models, is_urdf, require_reader
from phyagentos.runtime.models.urdf import ModelSource, describe_left_out, read_urdf

GRIPPER_ACTUATOR = "act_gripper"
GRIPPER_TENDON = "gripper_width"
MOUNT = "hand"  # the body that cameras of the wrist are mounted on
COLUMN, COLUMN_RADIUS_M, COLUMN_RGBA = "column", 0.05, (0.3, 0.3, 0.33, 1.0)
MOUNT_TO_TOOL_M = 0.1034  # from that body to the tool centre point, where a model has none of this name
# Friction decides a grasp: torsional contact (condim 4), stiff, above what the other body says.
_PAD = {
    "condim": 4,
    "priority": 2,
    "friction": [1.0, 0.02, 0.001],
    "solref": [0.005, 1.0],
    "solimp": [0.95, 0.99, 0.001, 0.5, 2.0],
    "group": 3,
    "mass": 0.0,
    "rgba": [0.9, 0.5, 0.2, 0.5],
}
_OPTIONS = ("cone", "impratio", "integrator", "timestep", "iterations", "tolerance", "noslip_iterations", "jacobian")
_MJCF_FOLDERS = ("meshdir", "texturedir", "assetdir")


def name_actuator(joint: str) -> str:
    """Name of the position servo of an arm joint."""
    return f"act_{joint}"


def read_profile(path: Path) -> tuple[TargetProfile, Path]:
    """Read `robots/<name>/target.yaml`.

    Returns:
        The profile, and the folder that its `model` is relative to.

    Raises:
        DefinitionError: With every problem: unknown keys, lists of unequal length, an absent model file.
    """
    located = read_yaml(path)
    profile = validate(TargetProfile, located)
    lists = {("arm", name): value for name, value in profile.arm if isinstance(value, tuple)}
    lists |= {("postures", name): value for name, value in profile.postures.items()}
    sizes = {"arm": len(profile.arm.joints), "postures": len(profile.arm.joints[profile.servoed])}
    problems = [
        located.problem(
            "INVALID_VALUE", address, f"{len(value)} values", f"{size}, one per joint", _advise_count(size - len(value))
        )
        for address, value in lists.items()
        if len(value) != (size := sizes[address[0]])
    ]
    needs_file = is_beside(profile.model) and (profile.model != "" or profile.kind == "simulation")
    if needs_file and not (path.parent / profile.model).is_file():
        problems.append(
            located.problem(
                "UNREADABLE_FILE",
                ("model",),
                repr(profile.model),
                f"a MJCF file in {path.parent}",
                format_hint(profile.model, [each.name for each in path.parent.glob("*.xml")]),
            )
        )
    steps = profile.control_period_s / profile.physics_step_s
    if abs(steps - round(steps)) > 1e-9 or round(steps) < 1:
        expected = f"a whole number of physics steps of {profile.physics_step_s:g} s"
        whole = max(1, round(steps)) * profile.physics_step_s
        hint = f"Write {whole:g}, or another physics_step_s."
        found = f"{profile.control_period_s:g}"
        problems.append(located.problem("INVALID_VALUE", ("control_period_s",), found, expected, hint))
    if problems:
        raise DefinitionError(problems)
    return profile, path.parent


def _advise_count(more: int) -> str:
    return f"Add {more}." if more > 0 else f"Remove {-more}."


def find_ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and all that carry it, from it to the world."""
    found = [body]
    while found[-1]:
        found.append(int(model.body_parentid[found[-1]]))
    return found


def count_steps(profile: TargetProfile) -> int:
    """Physics steps in one control period."""
    return round(profile.control_period_s / profile.physics_step_s)


def build_robot(profile: TargetProfile, folder: Path, *, is_free: bool = False) -> mujoco.MjSpec:
    """The mounted robot with its servos, as a spec to which more may be added.

    Arm joints get position servos `act_<joint>` with explicit stiffness, damping and torque limit; the fingers share
    one servo `act_gripper` on the tendon `gripper_width`, whose length is the opening. All bodies are
    gravity-compensated, as by the arm's own controller; but not where `is_free` lets a base stand by its weight.

    Raises:
        DefinitionError: As of `read_robot`.
    """
    spec = read_robot(profile, folder, is_free=is_free)
    for body in spec.bodies[1:] if profile.base is None else ():
        body.gravcomp = 1.0
    _add_servos(spec, profile)
    return spec


def compile_robot(profile: TargetProfile, folder: Path) -> mujoco.MjModel:
    """The mounted robot with its servos, alone; raises DefinitionError as of `read_robot` and `compile_model`."""
    return compile_model(build_robot(profile, folder), *find_models(profile, folder))


def read_robot(profile: TargetProfile, folder: Path, *, is_free: bool = False) -> mujoco.MjSpec:
    """The profile's model, with its hand, pads and tool, mounted; without what only a simulation of its own needs.

    A base slides and turns on the ground by joints of its own, or, where it `is_free`, stands on its wheels or legs.

    Raises:
        DefinitionError: When the model lacks a joint, pad or site that the profile names, cannot be read, or names a
            file outside of the folder of all robots (`LEADS_OUT`).
    """
    path = find_model(profile.model, folder)
    if is_beside(profile.model) and (problems := list(_iter_outside(path, folder.parent))):
        raise DefinitionError(problems)
    base = profile.base
    spec = read_base(profile, path)
    if profile.hand is not None:
        at = profile.hand.at
        hand = read_model(find_model(profile.hand.model, folder), profile.hand.arguments.as_texts()).spec
        _attach(spec, hand, _get_body(spec, at, path).add_frame(pos=at.position_m, quat=at.quaternion_wxyz))
    joints = [each.name for each in spec.joints]  # those that are parked too
    if base is None or profile.hand is not None:
        _park_others(spec, profile)
    for pad in profile.gripper.pad_boxes:
        _get_body(spec, pad, path).add_geom(
            name=pad.name, type=mujoco.mjtGeom.mjGEOM_BOX, pos=pad.position_m, quat=pad.quaternion_wxyz, **_PAD
        ).size = pad.half_m
    if profile.tool is not None:
        body, at = _get_body(spec, profile.tool, path), profile.tool
        body.add_site(name=profile.tcp, pos=at.position_m, quat=at.quaternion_wxyz, group=4)
        if spec.body(MOUNT) is None:
            back = compute_rotation(at.quaternion_wxyz) @ (0.0, 0.0, -MOUNT_TO_TOOL_M)
            body.add_body(name=MOUNT, pos=np.array(at.position_m) + back, quat=at.quaternion_wxyz)
    for body in spec.worldbody.bodies:
        body.pos, body.quat = profile.mount_position_m, profile.mount_quaternion_wxyz
    if base is not None:
        (free_base if is_free else put_on_plane)(spec, profile, base, path)
    elif profile.stands_on_column:
        _add_column(spec.worldbody.bodies[0], profile.mount_position_m[2])
    _check_names(joints, spec, profile, folder)
    for name, span in dict(profile.ranges).items():
        spec.joint(name).limited, spec.joint(name).range = True, span
    for joint in map(spec.joint, profile.arm.joints[profile.servoed]):
        if joint.range[0] == joint.range[1]:  # it turns without end: one turn to either side is enough
            joint.limited, joint.range = True, (-2 * np.pi, 2 * np.pi)
    return spec


def _attach(spec: mujoco.MjSpec, hand: mujoco.MjSpec, frame: mujoco.MjsFrame) -> None:
    for name in _OPTIONS:  # those of the arm: the scene sets them for all
        setattr(hand.option, name, getattr(spec.option, name))
    spec.attach(hand, prefix=HAND, frame=frame)


def _park_others(spec: mujoco.MjSpec, profile: TargetProfile) -> None:
    """Let joints stand still that are neither the target's nor of a hand at its end: those of another arm, a camera."""
    kept = {*profile.arm.joints, *profile.gripper.joints, *(profile.base.joints if profile.base is not None else ())}
    last, parked = spec.joint(profile.arm.joints[-1]), dict(profile.parked_rad)
    ends = (
        set[str]()
        if last is None or profile.hand is not None
        else {each.name for each in last.parent.find_all("joint")}
    )
    for joint in [each for each in spec.joints if each.name not in kept and not each.name.startswith(HAND)]:
        if joint.name not in ends or joint.name in parked:
            freeze(joint, parked.get(joint.name, 0.0))
            wound = [
                each for each in spec.tendons if joint.name in {wrap.target.name for wrap in each.path if wrap.target}
            ]
            gone = {joint.name, *(each.name for each in wound)}
            pairs = [each for each in spec.equalities if gone & {each.name1, each.name2}]
            for element in (*pairs, *wound, joint):
                spec.delete(element)


def _add_column(base: "mujoco.MjsBody", height_m: float) -> None:
    """A column under a base that is mounted above the level of the table's top."""
    base.add_geom(
        name=COLUMN,
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=compute_rotation(base.quat).T @ (0.0, 0.0, -height_m / 2),
        quat=base.quat * (1.0, -1.0, -1.0, -1.0),
        size=[COLUMN_RADIUS_M, height_m / 2, 0.0],
        rgba=COLUMN_RGBA,
    )


def read_base(profile: TargetProfile, path: Path) -> mujoco.MjSpec:
    """A profile's model at `path`, as of `read_model`: without its hand, all its joints there."""
    wheels = profile.base.wheels if profile.base is not None else None
    return read_model(path, profile.arguments.as_texts(), wheels.links if wheels is not None else ()).spec


def read_model(path: Path, arguments: Mapping[str, str] = {}, replaced: Collection[str] = ()) -> ModelSource:
    """A MJCF or URDF without actuators, sensors, key frames, cameras and lights, and without pictures that are absent.

    Args:
        path: Of the file.
        arguments: Values of those of a xacro file.
        replaced: Links of which a mesh may be absent even where it is solid.

    Raises:
        DefinitionError: `MODEL_INVALID`, `UNREADABLE_FILE`, also for the file of a solid.
    """
    require_reader(path)
    if is_urdf(path):
        source = read_urdf(path, arguments, replaced)
    else:
        try:
            source = ModelSource(mujoco.MjSpec.from_file(str(path)))
        except ValueError as error:
            raise DefinitionError(explain(str(error), path)) from error
    spec = source.spec
    _name_all(spec)
    left_out = settle_meshes(spec, path, list(dict.fromkeys(file.parent for file in iter_files(path))), replaced)
    for body in spec.bodies:
        body.mocap = False  # a mark that others move
    forces = {each.target: float(each.forcerange[1] * abs(each.gear[0])) for each in spec.actuators}
    for element in [*spec.actuators, *spec.sensors, *spec.keys, *spec.cameras, *spec.lights]:
        spec.delete(element)
    remarks = (*source.remarks, *map(describe_left_out, [left_out] if left_out else []))
    return replace(source, remarks=remarks, forces=forces)


def _name_all(spec: mujoco.MjSpec) -> None:
    """Name the bodies and joints of a MJCF that have no name, by which all else finds them."""
    for kind, elements in (("body", spec.bodies), ("joint", spec.joints)):
        taken = {element.name for element in elements}
        free = (name for index in count() if (name := f"{kind}_{index}") not in taken)
        for element in elements:
            element.name = element.name or next(free)


def read_remarks(profile: TargetProfile, folder: Path) -> tuple[str, ...]:
    """What was left out of the models of a profile, or added to them; raises DefinitionError as of `read_model`."""
    hands = [] if profile.hand is None else [(profile.hand.model, profile.hand.arguments)]
    models = [(profile.model, profile.arguments), *hands] if profile.model else []
    found = [read_model(find_model(model, folder), arguments.as_texts()) for model, arguments in models]
    return tuple(remark for each in found for remark in each.remarks)


def _get_body(spec: mujoco.MjSpec, at: Frame, path: Path) -> "mujoco.MjsBody":
    body = spec.body(at.body)
    if body is None:
        raise DefinitionError([Problem.unknown("body", str(path), at.body, [each.name for each in spec.bodies])])
    return body


def iter_files(path: Path) -> Iterator[Path]:
    """A model file and those of a MJCF that it includes or attaches, as far as they can be read."""
    yield path
    waiting, seen = [path], {path}
    while waiting:
        file = waiting.pop()
        folders, names = _list_names(file)
        found = {start / folder / name for start in (path.parent, file.parent) for folder in folders for name in names}
        fresh = {Path(os.path.normpath(each)) for each in found if each.suffix == ".xml" and each.is_file()} - seen
        yield from sorted(fresh)
        seen |= fresh
        waiting += fresh


def _list_names(file: Path) -> tuple[list[str], list[str]]:
    """Folders of assets and names of files in a MJCF."""
    try:
        elements = list(ElementTree.parse(file).iter())
    except (ElementTree.ParseError, OSError, UnicodeDecodeError):  # MuJoCo says it better
        return [""], []
    folders = ["", *(each.attrib[key] for each in elements for key in _MJCF_FOLDERS if key in each.attrib)]
    return folders, [value for each in elements for key, value in each.attrib.items() if key.startswith("file")]


def _iter_outside(path: Path, robots: Path) -> Iterator[Problem]:
    """Files that a MJCF and what it includes name outside of `robots`, which a copy of that folder would not hold."""
    place = Path(os.path.normpath(path)).relative_to(robots).parent.as_posix()
    for file in iter_files(path):
        folders, names = _list_names(file)
        for name in names:
            if any(leads_out(f"{folder}/{name}" if folder else name, place) for folder in folders):
                yield Problem("LEADS_OUT", str(file), repr(name), f"a file below {robots}", "Keep it with the model.")


def _check_names(joints: Sequence[str], spec: mujoco.MjSpec, profile: TargetProfile, folder: Path) -> None:
    """Raises DefinitionError `UNKNOWN_NAME` for each name that the model lacks, where it stands in the profile."""
    sites, geoms = [each.name for each in spec.sites], [each.name for each in spec.geoms if each.name]
    known = {"joint": joints, "geom": geoms, "site": sites}
    lists = {("arm", "joints"): profile.arm.joints, ("gripper", "joints"): profile.gripper.joints}
    base = profile.servoed.start
    wanted: list[tuple[str, Address, str]] = [
        ("joint", (*at, i), name)
        for at, names in lists.items()
        for i, name in enumerate(names)
        if at[0] == "gripper" or i >= base
    ]
    wanted += [("joint", ("ranges", name), name) for name in dict(profile.ranges)]
    wanted += [("geom", ("gripper", "pads", i), name) for i, name in enumerate(profile.gripper.pads)]
    wanted.append(("site", ("tcp",), profile.tcp))
    if missing := [each for each in wanted if each[2] not in known[each[0]]]:
        located = read_yaml(folder / "target.yaml")
        raise DefinitionError([located.unknown(kind, at, name, known[kind]) for kind, at, name in missing])


def _add_servos(spec: mujoco.MjSpec, profile: TargetProfile) -> None:
    arm, gripper = profile.arm, profile.gripper
    columns = (arm.joints, arm.stiffness_nm_rad, arm.damping_nms_rad, arm.torque_nm)
    for joint, kp, kv, torque in list(zip(*columns, strict=True))[profile.servoed]:
        servo = spec.add_actuator(name=name_actuator(joint), target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=kp, kv=kv)
        servo.forcelimited, servo.forcerange = True, (-torque, torque)
    for name in arm.joints[profile.servoed] if arm.armature_kg_m2 else ():
        spec.joint(name).armature = arm.armature_kg_m2
    if not gripper.joints:
        return
    tendon = spec.add_tendon(name=GRIPPER_TENDON)
    for joint, share in zip(gripper.joints, gripper.travel or [1.0] * len(gripper.joints), strict=True):
        tendon.wrap_joint(joint, share)
    servo = spec.add_actuator(name=GRIPPER_ACTUATOR, target=GRIPPER_TENDON, trntype=mujoco.mjtTrn.mjTRN_TENDON)
    servo.set_to_position(kp=gripper.stiffness_n_m, kv=gripper.damping_ns_m)
    servo.forcelimited, servo.forcerange = True, (-gripper.force_n, gripper.force_n)
