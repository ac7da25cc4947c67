"""A task as a project of this framework: scene file, goal graph, profile and limits, from what its environment says."""

import shutil
from pathlib import Path
from typing import Any

import msgspec
import mujoco
import numpy as np

from benchmarks.libero_parts.bddl import Inventory, format_graph, generate_graph, translate
from benchmarks.libero_parts.foreign_scenes import write_scene
from benchmarks.libero_parts.served import Server
from phyagentos.assembly.paths import TOKENS, open_project
from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Entity, Region

LIBRARY = Path(__file__).parent / "library"
ROBOT = "libero"
PROFILE = LIBRARY / "robots" / ROBOT / "target.yaml"


def read_profile() -> TargetProfile:
    """The profile of the arm, whatever its endpoint."""
    return read_target(PROFILE)


def write_project(folder: Path, scene: str, told: dict[str, Any], server: Server) -> Path:
    """The project of one task; its goal graph."""
    shutil.copytree(LIBRARY, folder, dirs_exist_ok=True)
    entities = [msgspec.convert(each, Entity) for each in told["entities"]]
    regions = [msgspec.convert(each, Region) for each in told["regions"]]
    path = folder / "scenes" / f"{scene}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    placed = {each.name: told["marks"][each.name] for each in regions}
    path.write_text(write_scene(scene, told["language"], entities, placed))
    inventory = Inventory(
        entities={each.name: each for each in entities},
        owners=told["owners"],
        rooms={name: mark["entity"] for name, mark in told["marks"].items()},
        regions={each.name: each.pose.position_m[2] - each.half_m[2] for each in regions},
    )
    name = scene.replace("/", "_")
    effects = translate(told["goal"], inventory)
    graph = folder / "goal_graphs" / f"{name}.yaml"
    graph.parent.mkdir(exist_ok=True)
    graph.write_text(format_graph(generate_graph(name, told["language"], scene, effects, inventory, ROBOT)))
    profile = folder / "robots" / ROBOT / "target.yaml"
    profile.write_text(PROFILE.read_text().replace("ws://127.0.0.1:7000", server.endpoint))
    write_model(profile.with_name("panda.xml"), told["tool"])
    return graph


def write_model(path: Path, tool: dict[str, float]) -> None:
    """This project's Panda with fingers as long as the environment's, and the tool between their pads."""
    spec = mujoco.MjSpec.from_file(str(find_shipped_root() / "robots" / "panda" / "panda.xml"))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    ours_m = float(np.linalg.norm(data.site("tcp").xpos - data.body("link7").xpos))
    shorter_m = ours_m - tool["flange_to_tool_m"]
    for name in ("left_finger", "right_finger"):
        spec.body(name).pos[2] -= shorter_m
    spec.site("tcp").pos[2] -= shorter_m
    path.write_text(spec.to_xml())


def open_workspace(root: Path, project: Path, server: Server) -> Workspace:
    """A workspace whose worker may connect to the server."""
    workspace = open_project(root, project)
    token = workspace.root / TOKENS / ROBOT
    token.parent.mkdir(parents=True, exist_ok=True)
    token.touch(mode=0o600)
    token.chmod(0o600)
    token.write_text(server.key.hex())
    return workspace
