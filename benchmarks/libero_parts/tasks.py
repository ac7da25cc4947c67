"""A task as a project of this framework: scene file, goal graph, profile and limits, from what its environment says."""

import re
import shutil
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import mujoco
import numpy as np

from benchmarks.libero_parts.bddl import Inventory, format_graph, generate_graph, read_places, translate
from benchmarks.libero_parts.foreign_scenes import Seen, Span, write_scene
from benchmarks.libero_parts.served import Server
from benchmarks.libero_parts.words import generate_from_words
from phyagentos.assembly.paths import TOKENS, open_project
from phyagentos.geometry import compute_rotation
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Entity, Region, Shape

LIBRARY = Path(__file__).parent / "library"
ROBOT = "libero"
FINGERS, OPEN_M = ("left_finger_joint", "right_finger_joint"), 0.08
WRIST, WRIST_BODY = "wrist", "link6"
PROFILE = LIBRARY / "robots" / ROBOT / "target.yaml"
LEARNED = Path(__file__).parent / "policy" / "skills" / "place_learned"
_PUT = re.compile(r"(?:inside|on)\((\w+), (\w+)\)")


def read_profile() -> TargetProfile:
    """The profile of the arm, whatever its endpoint."""
    return read_target(PROFILE)


def write_project(folder: Path, scene: str, told: dict[str, Any], server: Server, policy: str = "") -> Path:
    """The project of one task; its goal graph. What is put somewhere is put by the policy at an endpoint, if given."""
    entities = [msgspec.convert(each, Entity) for each in told["entities"]]
    regions = [msgspec.convert(each, Region) for each in told["regions"]]
    placed = {each.name: told["marks"][each.name] for each in regions}
    covers = {key: [msgspec.convert(each, Shape) for each in found] for key, found in told.get("covers", {}).items()}
    stand = [msgspec.convert(each, Shape) for each in told.get("stand", ())]
    seen = Seen(looks=told.get("looks", {}), covers=covers, areas=find_areas(told), stand=stand)
    inventory = Inventory(
        entities={each.name: each for each in entities},
        owners=told["owners"],
        rooms={name: mark["entity"] for name, mark in told["marks"].items()},
        regions={each.name: each.pose.position_m[2] - each.half_m[2] for each in regions},
    )
    effects = translate(told["goal"], inventory)
    generated = generate_graph(_name(scene), told["language"], scene, effects, inventory, ROBOT)
    if policy:
        use_policy(folder, generated, policy)
    written = write_scene(scene, told["language"], entities, placed, seen)
    return _write_files(folder, scene, written, generated, told, server)


def write_project_of_words(folder: Path, scene: str, told: dict[str, Any], server: Server) -> Path:
    """The project of one task of which nothing is known but its goal's words and the robot; its goal graph."""
    generated = generate_from_words(_name(scene), told["language"], scene, told["goal"], ROBOT)
    return _write_files(folder, scene, write_scene(scene, told["language"], [], {}, Seen()), generated, told, server)


def _name(scene: str) -> str:
    return scene.replace("/", "_")


def _write_files(
    folder: Path, scene: str, written: str, generated: dict[str, Any], told: dict[str, Any], server: Server
) -> Path:
    """The folder of the project, with scene, goal graph and the robot as this environment has it."""
    shutil.copytree(LIBRARY, folder, dirs_exist_ok=True)
    graph = folder / "goal_graphs" / f"{_name(scene)}.yaml"
    for path, text in ((folder / "scenes" / f"{scene}.yaml", written), (graph, format_graph(generated))):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    profile = folder / "robots" / ROBOT / "target.yaml"
    profile.write_text(PROFILE.read_text().replace("ws://127.0.0.1:7000", server.endpoint))
    masks = {part: [msgspec.convert(each, Shape) for each in told.get(part, ())] for part in ("hand", WRIST)}
    write_model(profile.with_name("panda.xml"), told["tool"], masks["hand"], masks[WRIST])
    return graph


def use_policy(folder: Path, graph: dict[str, Any], endpoint: str) -> None:
    """Let the learned skill, served at an endpoint, put whatever the graph wants put; other nodes stay as they are."""
    skill = shutil.copytree(LEARNED, folder / "skills" / LEARNED.name, dirs_exist_ok=True) / "SKILL.md"
    skill.write_text(re.sub("endpoint: .*", f"endpoint: {endpoint}", skill.read_text()))
    for node in graph["sessions"].values():
        if put := _PUT.fullmatch(node["skill"]["guarantees"]):
            node |= {"skill": LEARNED.name, "with": {"object": put[1], "destination": put[2]}}


def find_areas(told: dict[str, Any]) -> dict[str, list[Span]]:
    """Spans of x and y in which each of several equal objects begins, as its task says: no picture tells them apart."""
    places, regions = read_places(told["goal"]), {each["name"]: each for each in told["regions"]}
    kinds = Counter(each["kind"] for each in told["entities"])
    areas = {}
    for each in told["entities"]:
        place = places.get(each["name"], "")
        while place not in regions and place in places:  # what it stands on has a place itself
            place = places[place]
        if kinds[each["kind"]] > 1 and place in regions:
            middle, half = regions[place]["pose"]["position_m"], regions[place]["half_m"]
            areas[each["name"]] = [(middle[axis] - half[axis], middle[axis] + half[axis]) for axis in range(2)]
    return areas


def write_model(path: Path, tool: Mapping[str, Any], hand: Sequence[Shape], wrist: Sequence[Shape]) -> None:
    """This project's Panda with fingers as long as the environment's, and the tool between their pads.

    `ranges_rad` are those of the environment's joints, where it says any. The boxes of `hand` and `wrist`, as they are
    with all joints at zero and the fingers apart, only mask pictures.
    """
    spec = mujoco.MjSpec.from_file(str(find_shipped_root() / "robots" / "panda" / "panda.xml"))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ours_m = float(np.linalg.norm(data.site("tcp").xpos - data.body("link7").xpos))
    shorter_m = ours_m - tool["flange_to_tool_m"]
    for name in ("left_finger", "right_finger"):
        spec.body(name).pos[2] -= shorter_m
    spec.site("tcp").pos[2] -= shorter_m
    for name, range_rad in tool.get("ranges_rad", {}).items():
        spec.joint(name).range = range_rad
    _add_seen(spec, hand, wrist)
    path.write_text(spec.to_xml())


def _add_seen(spec: mujoco.MjSpec, hand: Sequence[Shape], wrist: Sequence[Shape]) -> None:
    """Boxes that touch nothing: each finger has what is beyond where it begins, on its side; the palm has the rest."""
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[[model.joint(name).qposadr[0] for name in FINGERS]] = OPEN_M / 2.0
    mujoco.mj_kinematics(model, data)
    fingers = [int(model.joint(name).bodyid[0]) for name in FINGERS]
    palm, into_tool = int(model.body_parentid[fingers[0]]), data.site("tcp").xmat.reshape(3, 3).T
    begin_m = (into_tool @ (data.xpos[fingers] - data.site("tcp").xpos).T).T  # z points away from the palm
    for shape in wrist:
        _add_box(spec, model, data, model.body(WRIST_BODY).id, shape)
    for shape in hand:
        at_m = into_tool @ (np.array(shape.pose.position_m) - data.site("tcp").xpos)
        side = int(np.argmax(begin_m[:, 1] * at_m[1]))
        _add_box(spec, model, data, fingers[side] if at_m[2] > begin_m[side, 2] else palm, shape)


def _add_box(spec: mujoco.MjSpec, model: Any, data: Any, body: int, shape: Shape) -> None:
    place, quaternion = data.xmat[body].reshape(3, 3), np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ravel(place.T @ compute_rotation(shape.pose.quaternion_wxyz)))
    spec.body(model.body(body).name).add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=shape.size_m, pos=place.T @ (shape.pose.position_m - data.xpos[body]),
        quat=quaternion, contype=0, conaffinity=0, group=2, mass=0.0,
    )  # fmt: skip


def open_workspace(root: Path, project: Path, server: Server, robot: str = ROBOT) -> Workspace:
    """A workspace whose worker may connect to the server."""
    workspace = open_project(root, project)
    token = workspace.root / TOKENS / robot
    token.parent.mkdir(parents=True, exist_ok=True)
    token.touch(mode=0o600)
    token.chmod(0o600)
    token.write_text(server.key.hex())
    return workspace
