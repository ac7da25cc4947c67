"""A project with a cube hidden in a closed drawer, and skills that an agent directs to find it."""

from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
SKILL = """---
skill: {name}
description: Finds a thing and puts it into a container, as an agent decides.
kind: agent_loop
parameters:
  object: {{type: entity, description: What to find.}}
  destination: {{type: place, description: What to put it into.}}
guarantees: ["inside(${{object}}, ${{destination}})"]
needs:
  observations: [joint_state, gripper_width, entity_poses]
  actions: [joint_position, gripper_width]
  capabilities: [manipulation]
loop: {loop}
---

# {name}

The agent opens what may hide the thing, looks, and puts it away.
"""
TOOLS = ["open_drawer", "home", "pick_and_place"]
OPEN = {"call": "invoke_tool", "tool": "open_drawer", "arguments": {"drawer": "drawer", "handle": "handle"}}
PUT = {"call": "invoke_tool", "tool": "pick_and_place"}
PUT |= {"arguments": {"object": "${object}", "destination": "${destination}"}}
HOME = {"call": "invoke_tool", "tool": "home"}
RAISED_M, HALF_M = 0.012, 0.022  # of the cabinet, and of the cube's edge
LOOPS = {
    "outside": {"tools": TOOLS, "calls": 8},
    "scripted": {
        "tools": TOOLS,
        "procedure": [OPEN | {"when": "not visible(${object})"}, HOME, {"call": "observe"}, PUT, {"call": "finish"}],
    },
    "liar": {"tools": TOOLS, "procedure": [{"call": "finish", "reason": "it is in the tray, believe me"}]},
}


def make_project(folder: Path) -> Path:
    """The folder, with a scene, a skill for each of `LOOPS`, and a goal graph for each skill."""
    scene = yaml.safe_load((ROOT / "scenes/tabletop/drawer.yaml").read_text(encoding="utf-8"))
    trays = yaml.safe_load((ROOT / "scenes/tabletop/cubes_and_trays.yaml").read_text(encoding="utf-8"))
    tray = trays["bodies"]["green_tray"]
    scene["scene"] = "hidden"
    scene["materials"] = trays["materials"] | scene["materials"]
    scene["bodies"]["drawer"]["joint"]["opening"] = [0.0, 0.0]
    roof, *walls = scene["bodies"]["cabinet"]["shapes"][1:]  # higher, so that a hand reaches what the drawer holds
    roof["position_m"][2] += 2 * RAISED_M
    for wall in walls:
        wall["position_m"][2] += RAISED_M
        wall["size_m"][2] += RAISED_M
    cube = {"shapes": [{"kind": "box", "size_m": [HALF_M] * 3}]}
    cube["place"] = {"frame": "drawer", "position_m": [-0.04, 0.0, 0.0042 + HALF_M]}
    scene["bodies"]["green_cube"] |= cube
    scene["bodies"]["green_tray"] = tray | {"place": {"position_m": [0.42, -0.3, 0.0]}}
    del scene["bodies"]["blue_cube"]
    put(folder / "scenes/hidden.yaml", yaml.safe_dump(scene, sort_keys=False))
    for name, loop in LOOPS.items():
        put(
            folder / f"skills/{name}/SKILL.md",
            SKILL.format(name=name, loop=yaml.safe_dump(loop, default_flow_style=True)),
        )
        put(folder / f"goal_graphs/{name}.yaml", yaml.safe_dump(make_graph(name), sort_keys=False))
    return folder


def make_graph(skill: str) -> dict[str, object]:
    """Find the green cube, and put it into its tray."""
    arguments = {"object": "green_cube", "destination": "green_tray"}
    return {
        "goal": skill,
        "objective": "Find the green cube and put it into its tray.",
        "scene": "hidden",
        "targets": {"arm": "panda"},
        "defaults": {"timeout_s": 60, "max_replans": 0},
        "sessions": {"find": {"skill": skill, "target": "arm", "with": arguments}},
        "accept": ["inside(green_cube, green_tray)"],
    }


def put(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
