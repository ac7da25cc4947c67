"""A case as the robot gets it: scene and goal graph, in the formats of this project.

What these formats cannot say is left out, and named in `benchmarks/unseen.py`: it is never imitated.
"""

from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any

import yaml

from benchmarks.worlds.cases import Case
from benchmarks.worlds.rooms import TABLE_RGB, TABLE_X_M, TABLE_Y_M, Room, SceneObject

FOLDER = "unseen"


def write_project(folder: Path, scene: dict[str, Any], graph: dict[str, Any], **others: Any) -> Path:
    """A project with a scene, a goal graph, and other files by their names without `.yaml`; the path of the graph."""
    path = folder / "goal_graphs" / f"{graph['goal']}.yaml"
    files = {path: graph, folder / "scenes" / f"{scene['scene']}.yaml": scene}
    for file, data in (files | {folder / f"{name}.yaml": data for name, data in others.items()}).items():
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(yaml.safe_dump(data, sort_keys=False, allow_unicode=True))
    return path


def render_scene(room: Room, name: str) -> dict[str, Any]:
    """The scene file of a room."""
    center = ((TABLE_X_M[0] + TABLE_X_M[1]) / 2, (TABLE_Y_M[0] + TABLE_Y_M[1]) / 2)
    half = ((TABLE_X_M[1] - TABLE_X_M[0]) / 2, (TABLE_Y_M[1] - TABLE_Y_M[0]) / 2)
    materials: dict[str, object] = {
        "wood": {"rgba": [*TABLE_RGB, 1.0], "surface": "wood"},
        "floor": {"rgba": [0.82, 0.84, 0.87, 1.0]},
    }
    materials |= {t.name: {"rgba": [*t.rgb, 1.0], "surface": t.surface} for t in room.objects.values()}
    materials |= {f"print_{i}": {"rgba": [*one.rgb, 1.0]} for i, one in enumerate(room.prints)}
    top: list[dict[str, object]] = [{"kind": "box", "size_m": [*half, 0.02]}]
    for index, one in enumerate(room.prints):
        at = [one.at_m[0] - center[0], one.at_m[1] - center[1], one.at_m[2] + 0.02]
        flat = {"kind": "box", "size_m": list(one.half_m), "position_m": at, "euler_rad": [0.0, 0.0, one.yaw_rad]}
        top.append(flat | {"material": f"print_{index}", "decor": True})
    bodies: dict[str, object] = {
        "table": _fix("table", "wood", [*center, -0.02], top),
        "floor": _fix("floor", "floor", [0.4, 0.0, -0.77], [{"kind": "box", "size_m": [3.0, 3.0, 0.02]}]),
    }
    bodies |= {item.name: _render_object(item) for item in room.objects.values()}
    return {
        "scene": f"{FOLDER}/{name}",
        "description": f"A room drawn from seed {room.seed}.",
        "materials": materials,
        "areas": {
            f"place_of_{item.name}": {"x_m": [item.at_m[0]] * 2, "y_m": [item.at_m[1]] * 2}
            for item in room.objects.values()
            if item.drawn_by == "area"
        },
        "bodies": bodies,
        "regions": {
            spot.name: {"center_m": list(spot.center_m), "half_m": list(spot.half_m)} for spot in room.spots.values()
        },
        "cameras": {"overview": {"position_m": [1.85, 0.46, 1.15], "target_m": [0.27, 0.05, 0.26], "fovy_deg": 41}},
        "friction": {} if room.friction is None else _even_out(room, room.friction),
        "lights": {"key": {"position_m": [1.2, -1.2, 2.2], "direction": [-0.4, 0.55, -1.0]}},
        "settle_s": 1.5,
    }


def _even_out(room: Room, friction: tuple[float, float]) -> dict[str, object]:
    """The same friction for every pair of surfaces in the room."""
    surfaces = sorted({"wood", "rubber", *(item.surface for item in room.objects.values())})
    return {f"{one}|{other}": list(friction) for one, other in combinations_with_replacement(surfaces, 2)}


def _fix(kind: str, material: str, at: list[float], shapes: list[dict[str, object]]) -> dict[str, object]:
    return {"kind": kind, "fixed": True, "material": material, "place": {"position_m": at}, "shapes": shapes}


def _render_object(item: SceneObject) -> dict[str, object]:
    body: dict[str, object] = {"kind": item.form.kind, "color": item.color, "material": item.name}
    if item.fixed:
        body["fixed"] = True
    else:
        body |= {"mass_kg": item.mass_kg, "grip_span": list(item.grip)}
    body["shapes"] = [
        {
            "kind": solid.kind,
            "size_m": [float(value) for value in solid.size_m],
            "position_m": [float(value) for value in solid.at_m],
            "euler_rad": [float(value) for value in solid.euler_rad],
        }
        for solid in item.form.solids
    ]
    if item.form.interior:
        center, half = item.form.interior
        body["interior"] = {"center_m": [float(v) for v in center], "half_m": [float(v) for v in half]}
    body["place"] = _render_place(item)
    return body


def _render_place(item: SceneObject) -> dict[str, object]:
    x, y, z = (float(value) for value in item.at_m)
    yaw: object = [-3.14159, 3.14159] if item.yaw_rad is None else item.yaw_rad
    if any(item.euler_rad):
        return {"position_m": [x, y, z], "yaw_rad": yaw, "euler_rad": list(item.euler_rad)}
    if item.drawn_by == "area":
        return {"area": f"place_of_{item.name}", "position_m": [0.0, 0.0, z], "yaw_rad": yaw}
    if item.drawn_by == "frame":
        origin = ((TABLE_X_M[0] + TABLE_X_M[1]) / 2, (TABLE_Y_M[0] + TABLE_Y_M[1]) / 2, -0.02)
        local = [a - b for a, b in zip((x, y, z), origin, strict=True)]
        return {"frame": "table", "position_m": local, "yaw_rad": yaw}
    return {"position_m": [x, y, z], "yaw_rad": yaw}


def render_goal(case: Case) -> dict[str, Any]:
    """The goal graph of a case."""
    data: dict[str, object] = {
        "goal": case.name,
        "objective": "; ".join(text for node in case.nodes for text in node.accept) + ".",
        "scene": f"{FOLDER}/{case.name}",
        "targets": {"arm": "panda"},
        "defaults": {"timeout_s": 60, "max_replans": 2},
    }
    if case.constraints:
        data["constraints"] = list(case.constraints)
    if case.interchangeable:
        data["interchangeable"] = [list(names) for names in case.interchangeable]
    data["sessions"] = {
        node.name: {"skill": node.skill, "target": "arm", "with": dict(node.arguments), "accept": list(node.accept)}
        | ({"after": list(node.after)} if node.after else {})
        for node in case.nodes
    }
    if case.accept:
        data["accept"] = list(case.accept)
    return data
