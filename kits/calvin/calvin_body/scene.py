"""The objects of CALVIN's simulation as entities: blocks, the table's parts, what slides and what it switches."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pybullet as p
from numpy.typing import NDArray
from target_server.body import Entity
from target_server.mujoco_objects import Joint, Solid, find_handle, to_quaternion

from calvin_body.meshes import Box, bound, fill, read_mesh

Array = NDArray[np.float64]
NAMES = {"plank_link": "sliding_cabinet", "slide_link": "sliding_door", "base_link": "table", "led_link": "led_light",
         "light_link": "light_bulb"}  # fmt: skip
"""What parts are called where the model has no word for them; another name is without what the model puts before it."""
ALONG = 0.9  # cosine of the angle up to which two directions are one
SHELF_M = 0.12  # height of the room above a shelf
HALF = 0.5  # of its way, at which a switch lights its lamp
FRONT = 0.3  # of the largest panel, that of a drawer's front at least
Key = tuple[int, int]  # of a link: body and number
TURN = np.array(((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
"""From CALVIN's axes to ours: x across the table, as a person looks who stands before it."""


@dataclass(frozen=True)
class Part:
    """One object: a link of a body, or its handle."""

    name: str
    kind: str
    link: Key
    solids: tuple[Solid, ...]
    movable: bool
    joint: Joint | None = None
    part_of: str = ""
    lamp: Any = None


def rotate(quaternion_xyzw: Sequence[float]) -> Array:
    """(3, 3)."""
    found: Array = np.array(p.getMatrixFromQuaternion(quaternion_xyzw)).reshape(3, 3)
    return found


class Scene:
    """Where everything is, in the frame of the robot's base."""

    def __init__(self, env: Any, base_m: Array) -> None:
        self._env, self._base_m, self._cid = env, base_m, env.cid
        self.parts = [*self._list_blocks(), *self._list_table()]

    def list_entities(self, target: str, held: Sequence[str]) -> list[Entity]:
        """All of them now."""
        return [self._read(each, target, held) for each in self.parts]

    def list_touched(self, robot: int, links: Sequence[int]) -> set[str]:
        """Names of what moves and these links of the robot touch; of a link that has a handle, the handle's."""
        contacts = (c for link in links for c in p.getContactPoints(robot, -1, link, physicsClientId=self._cid))
        names = {each.link: each.name for each in self.parts if each.movable}  # the handle comes later
        return {names[key] for key in {(c[2], c[4]) for c in contacts} if key in names}

    def _list_blocks(self) -> Iterator[Part]:
        for block in self._env.scene.movable_objects:
            size = np.array(p.getCollisionShapeData(block.uid, -1, physicsClientId=self._cid)[0][3]) / 2.0
            yield Part(block.name, "block", (block.uid, -1), (_make_box((-size, size)),), movable=True)

    def _list_table(self) -> Iterator[Part]:
        scene = self._env.scene
        for table in scene.fixed_objects:
            words = {number: word for word, number in table.info_dict["links"].items()}
            for link in range(-1, table.num_joints):
                solids = tuple(map(_make_box, self._read_boxes(table.uid, link)))
                part = Part(_name(words[link]), "table" if link < 0 else "fixture", (table.uid, link), solids, False)
                lamp = next((each for each in scene.lights if each.link_id == link), None)
                control = next(
                    (c for c in (*scene.buttons, *scene.switches) if link in (c.joint_index, c.light.link_id)), None
                )
                if control is None:
                    yield from self._add_joint(part)
                elif lamp is None:  # what switches a lamp is a part of it
                    owner = _name(words[control.light.link_id])
                    joint = self._read_joint(part.link) if control in scene.buttons else None
                    yield replace(part, kind=part.name, movable=True, joint=joint, part_of=owner)
                else:
                    joint = self._read_joint((table.uid, control.joint_index))
                    toggled = lamp if control in scene.buttons else None
                    yield replace(part, kind="lamp", movable=True, joint=joint, lamp=toggled)

    def _read_joint(self, link: Key) -> Joint | None:
        """The slide by which a link moves, if it does."""
        info = p.getJointInfo(*link, physicsClientId=self._cid) if link[1] >= 0 else None
        if info is None or info[2] != p.JOINT_PRISMATIC:
            return None
        return Joint("slide", link[1], info[8], info[9], np.array(info[13]), np.zeros(3))

    def _add_joint(self, part: Part) -> Iterator[Part]:
        """A part of the table, and the handle of what slides."""
        joint, solids = self._read_joint(part.link), part.solids
        if joint is None:
            yield part
            return
        handle = find_handle(solids, joint if _has_front(solids, joint.axis) else replace(joint, kind="hinge"))
        own = tuple(each for index, each in enumerate(solids) if index not in handle)
        yield replace(part, kind=part.name.split("_")[-1], solids=own, movable=True, joint=joint)
        if handle:
            taken = tuple(solids[index] for index in sorted(handle))
            yield Part(f"{part.name}_handle", "handle", part.link, taken, movable=True, part_of=part.name)

    def _read_boxes(self, body: int, link: int) -> Iterator[Box]:
        for shape in p.getCollisionShapeData(body, link, physicsClientId=self._cid)[:1]:
            pieces = read_mesh(Path(shape[4].decode()))
            for vertices, triangles in pieces:
                scaled = vertices * np.array(shape[3])
                yield from fill(scaled, triangles) if link < 0 else (bound(scaled, triangles),)

    def locate(self, link: Key) -> tuple[Array, Array]:
        """Position (3,) and rotation (3, 3) of the frame of a link."""
        if link[1] >= 0:
            state = p.getLinkState(*link, computeForwardKinematics=True, physicsClientId=self._cid)[4:6]
        elif table := next((each for each in self._env.scene.fixed_objects if each.uid == link[0]), None):
            state = table.initial_pos, table.initial_orn  # its base has no mass, and stands where it was put
        else:
            state = p.getBasePositionAndOrientation(link[0], physicsClientId=self._cid)
        return TURN @ (np.array(state[0]) - self._base_m), TURN @ rotate(state[1])

    def _read(self, part: Part, target: str, held: Sequence[str]) -> Entity:
        position_m, rotation = self.locate(part.link)
        more: dict[str, Any] = {"part_of": part.part_of} if part.part_of else {}
        if part.name in held:
            more["held_by"] = target
        if part.kind == "fixture":  # a shelf: there is room on it
            more["interior"] = _find_room_above(part.solids[0], rotation)
        if part.link[1] < 0 and part.movable:
            speed = p.getBaseVelocity(part.link[0], physicsClientId=self._cid)[0]
            more["speed_m_s"] = float(np.linalg.norm(speed))
        if part.joint is not None:
            more |= self._describe_joint(part, part.joint, position_m, rotation)
        shapes = [each.encode() for each in part.solids]
        x, y, z = position_m.tolist()
        a, b, c, d = to_quaternion(rotation)
        return Entity(part.name, part.kind, (x, y, z), (a, b, c, d), part.movable, shapes, more)

    def _describe_joint(self, part: Part, joint: Joint, position_m: Array, rotation: Array) -> Mapping[str, Any]:
        """A lamp is as open as its switch is moved; one that a button toggles is open while it is lit."""
        body, slide = part.link[0], joint.address
        at = float(p.getJointState(body, slide, physicsClientId=self._cid)[0])
        axis, closed_m = joint.axis, position_m
        if slide == part.link[1]:
            closed_m = position_m - rotation @ axis * (at - joint.closed)
        else:
            axis = rotation.T @ self.locate((body, slide))[1] @ axis
        share = (at - joint.closed) / joint.travel if part.lamp is None else float(part.lamp.get_state())
        pose = {"position_m": closed_m.tolist(), "quaternion_wxyz": to_quaternion(rotation)}
        kind = "slide" if part.lamp is None else "toggle"
        how = {"kind": kind, "axis": axis.tolist(), "travel": joint.travel, "closed": pose}
        if part.kind == "lamp":
            how |= {"opens_at": HALF, "closes_at": HALF}
        found: dict[str, Any] = {"joint": min(max(share, 0.0), 1.0), "mechanism": how}
        if (room := find_room(part.solids, rotation)) is not None:
            found["interior"] = {"center_m": room[0].tolist(), "half_m": room[1].tolist()}
        return found


def _find_room_above(plate: Solid, rotation: Array) -> Mapping[str, Any]:
    up = (rotation.T @ np.array((0.0, 0.0, 1.0))).round(6)
    half_m = plate.half_m * (1.0 - np.abs(up)) + np.abs(up) * SHELF_M / 2.0
    center_m = plate.center_m + up * (np.abs(up) @ plate.half_m + SHELF_M / 2.0)
    return {"center_m": center_m.tolist(), "half_m": half_m.tolist()}


def _has_front(solids: Sequence[Solid], axis: Array) -> bool:
    """Whether a large panel is across the axis (3,), as of a drawer; a sliding door is along it."""
    areas = [(abs(axis[int(np.argmin(s.half_m))]) > ALONG, float(np.sort(s.half_m)[1:].prod())) for s in solids]
    return max((area for is_across, area in areas if is_across), default=0.0) > FRONT * max(area for _, area in areas)


def _name(word: str) -> str:
    return NAMES.get(word, word.removesuffix("_link"))


def _make_box(box: Box) -> Solid:
    low, high = box
    half = (high - low) / 2.0
    return Solid("box", half, (low + high) / 2.0, np.eye(3), half)


def find_room(solids: Sequence[Solid], rotation: Array) -> tuple[Array, Array] | None:
    """Middle and half sides of the room that walls and a floor enclose, open upwards; None where a side is open."""
    low = np.min([each.center_m - each.half_m for each in solids], axis=0)
    high = np.max([each.center_m + each.half_m for each in solids], axis=0)
    up = rotation.T @ np.array((0.0, 0.0, 1.0))
    middle, vertical = (low + high) / 2.0, int(np.argmax(np.abs(up)))
    ends = np.stack((low, high))
    for axis in range(3):
        others = [each for each in range(3) if each != axis]
        across = [each for each in solids if np.all(np.abs(each.center_m - middle)[others] <= each.half_m[others])]
        for side, sign in enumerate((-1.0, 1.0)):
            faces = [s.center_m[axis] - sign * s.half_m[axis] for s in across if sign * (s.center_m - middle)[axis] > 0]
            if faces:
                ends[side, axis] = min(faces, key=lambda face: abs(face - middle[axis]))
            elif not (axis == vertical and sign == np.sign(up[vertical])):
                return None
    return ends.mean(axis=0), np.ptp(ends, axis=0) / 2.0
