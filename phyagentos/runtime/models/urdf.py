"""URDF as MuJoCo can read it: files of packages are found, inertias made valid, every link is kept."""

import os
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import mujoco
import numpy as np

from phyagentos.errors import DefinitionError, Problem
from phyagentos.runtime.models.compiling import explain
from phyagentos.runtime.models.meshes import find_mesh
from phyagentos.runtime.models.xacro import expand_xacro

_COMPILER = {"balanceinertia": "true", "discardvisual": "false", "fusestatic": "false", "strippath": "false"}
_MOVES = ("revolute", "continuous", "prismatic")
_COUNTS = {
    **dict.fromkeys(("xyz", "rpy", "scale"), 3),
    **dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz", "lower", "upper", "effort", "velocity"), 1),
    **dict.fromkeys(("radius", "length", "multiplier", "offset", "damping", "friction"), 1),
}  # of numbers in an attribute
_NOT_NEGATIVE = {"radius", "length", "size", "effort", "velocity", "value"}
_SIZES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",), "capsule": ("radius", "length")}
_AXES = ("xx", "yy", "zz", "xy", "xz", "yz")
_PRODUCTS = dict.fromkeys(("ixy", "ixz", "iyz"), "0")
_MATTER = ("inertial", "visual", "collision")


@dataclass(frozen=True, slots=True)
class ModelSource:
    """A model as its file has it.

    Attributes:
        remarks: What was left out or added, for people.
        speeds: Of joints, where a URDF says them [rad/s].
        forces: Largest ones of joints, where the motors of a MJCF say them [N m or N].
    """

    spec: mujoco.MjSpec
    remarks: tuple[str, ...] = ()
    speeds: Mapping[str, float] = field(default_factory=dict)
    forces: Mapping[str, float] = field(default_factory=dict)


def read_urdf(path: Path, arguments: Mapping[str, str] = {}, replaced: Collection[str] = ()) -> ModelSource:
    """Read a URDF or xacro file, the latter with values of its arguments.

    A visual whose mesh is absent or of no kind that is read is left out; so is any of `replaced` links.

    Raises:
        DefinitionError: `MODEL_INVALID`, `UNREADABLE_FILE` for a collision mesh, `UNKNOWN_NAME`, each at its line.
    """
    try:
        text = expand_xacro(path, arguments) if path.suffix == ".xacro" else path.read_bytes()
        document = _Document.parse(text, path)
    except OSError as error:
        raise DefinitionError.of(
            "UNREADABLE_FILE", str(path), str(error.strerror), "a file that can be read"
        ) from error
    except expat.ExpatError as error:
        raise DefinitionError.of(
            "MODEL_INVALID", f"{path}:{error.lineno}", f"no whole XML: {error}", "every tag closed, and text in UTF-8"
        ) from error
    if problems := list(document.iter_problems()):
        raise DefinitionError(problems)
    folder = next((each.get("meshdir", "") for each in document.robot.findall("mujoco/compiler")), "")
    for element in document.robot.findall("mujoco"):
        document.robot.remove(element)
    remarks = [*document.settle_shapes(folder, replaced), *document.give_mass(), *document.release()]
    extension = ElementTree.SubElement(document.robot, "mujoco")
    ElementTree.SubElement(extension, "compiler", _COMPILER)
    try:
        spec = mujoco.MjSpec.from_string(ElementTree.tostring(document.robot, encoding="unicode"))
    except ValueError as error:
        raise DefinitionError(explain(str(error), path)) from error
    limits = {name: joint.find("limit") for name, joint in document.joints().items()}
    return ModelSource(
        spec,
        tuple(remarks),
        speeds={name: float(each.get("velocity", 0.0)) for name, each in limits.items() if each is not None},
    )


@dataclass(frozen=True, slots=True)
class _Document:
    """The elements of a URDF, with their lines where these are those of the file."""

    path: Path
    robot: ElementTree.Element
    lines: Mapping[ElementTree.Element, int]

    @classmethod
    def parse(cls, text: str | bytes, path: Path) -> "_Document":
        builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
        lines: dict[ElementTree.Element, int] = {}

        def start(tag: str, attributes: dict[str, str]) -> None:
            lines[builder.start(tag, attributes)] = parser.CurrentLineNumber

        parser.StartElementHandler, parser.EndElementHandler = start, builder.end
        parser.Parse(text, True)
        return cls(path, builder.close(), {} if path.suffix == ".xacro" else lines)

    def locate(self, element: ElementTree.Element) -> str:
        line = self.lines.get(element)
        return f"{self.path}:{line}" if line else str(self.path)

    def links(self) -> dict[str, ElementTree.Element]:
        return {each.get("name", ""): each for each in self.robot.findall("link")}

    def joints(self) -> dict[str, ElementTree.Element]:
        return {each.get("name", ""): each for each in self.robot.findall("joint")}

    def iter_problems(self) -> Iterator[Problem]:
        """All that no compiler could make a robot of."""
        if self.robot.tag != "robot":
            yield Problem(
                "MODEL_INVALID",
                self.locate(self.robot),
                found=f"a file that begins with <{self.robot.tag}>",
                expected="<robot>, a URDF, or <mujoco> in an .xml",
            )
            return
        numbers = list(self._iter_numbers())
        yield from numbers or [*self._iter_names(), *self._iter_joints()]

    def _problem(self, element: ElementTree.Element, found: str, expected: str) -> Problem:
        return Problem("MODEL_INVALID", self.locate(element), found, expected)

    def _iter_numbers(self) -> Iterator[Problem]:
        for element in self.robot.iter():
            counts = dict(_COUNTS) | {"mass": {"value": 1}, "box": {"size": 3}}.get(element.tag, {})
            for name in counts.keys() & element.keys():
                values, expected = element.attrib[name].split(), counts[name]
                if len(values) != expected or not all(map(_is_finite, values)):
                    yield self._problem(
                        element,
                        found=f'<{element.tag} {name}="{element.attrib[name]}">',
                        expected="a number" if expected == 1 else f"{expected} numbers",
                    )
                elif name in _NOT_NEGATIVE and min(map(float, values)) < 0.0:
                    yield self._problem(element, f'<{element.tag} {name}="{element.attrib[name]}">', "none below zero")

    def _iter_names(self) -> Iterator[Problem]:
        for tag in ("link", "joint"):
            names = [each.get("name", "") for each in self.robot.findall(tag)]
            for index, element in enumerate(self.robot.findall(tag)):
                if not names[index] or names[index] in names[:index]:
                    yield self._problem(element, f"{tag} {names[index]!r} twice", f"a name of its own for each {tag}")
        for name, link in self.links().items():
            lacks = [
                tag
                for tag in ("mass", "inertia")
                if link.find("inertial") is not None and link.find(f"inertial/{tag}") is None
            ]
            if lacks:
                yield self._problem(
                    link, f"link {name!r} with an <inertial> without {' and '.join(lacks)}", "both, or none"
                )

    def _iter_joints(self) -> Iterator[Problem]:
        links, joints, children = self.links(), self.joints(), set[str]()
        for name, joint in joints.items():
            for tag in ("parent", "child"):
                if (link := _get(joint, tag, "link")) not in links:
                    yield Problem.unknown(
                        "link", self.locate(joint), link, links, found=f"{link!r}, the {tag} of joint {name!r}"
                    )
            child, kind = _get(joint, "child", "link"), joint.get("type", "")
            if child in children:
                yield self._problem(joint, f"joint {name!r} holds link {child!r}, which another holds", "one parent")
            children.add(child)
            if kind not in {*_MOVES, "fixed"}:
                expected = f'type="fixed", or {", ".join(_MOVES)}; a base that moves is the group `base` of a profile'
                yield self._problem(joint, f"joint {name!r} of the type {kind!r}", expected)
            elif kind in _MOVES:
                yield from self._iter_motion(name, joint)
        reached = links.keys() - children
        while (
            fresh := {
                _get(each, "child", "link") for each in joints.values() if _get(each, "parent", "link") in reached
            }
            - reached
        ):
            reached |= fresh
        is_whole = children <= links.keys() and all(_get(each, "parent", "link") in links for each in joints.values())
        for name in [each for each in links if each not in reached] if is_whole else ():
            yield self._problem(links[name], f"link {name!r} in a ring of joints", "one link that is no joint's child")

    def _iter_motion(self, name: str, joint: ElementTree.Element) -> Iterator[Problem]:
        limit, mimic = joint.find("limit"), joint.find("mimic")
        if limit is not None and joint.get("type") != "continuous":
            low, high = float(limit.get("lower", 0.0)), float(limit.get("upper", 0.0))
            if low > high:
                found = f"joint {name!r} with lower {low:g} above upper {high:g}"
                yield self._problem(limit, found, "the lesser one as lower")
        if mimic is not None:
            others = [each for each, found in self.joints().items() if found.get("type") in _MOVES and each != name]
            if (leader := mimic.get("joint", "")) == name:
                yield self._problem(mimic, f"joint {name!r} that mimics itself", "the joint that it follows")
            elif leader not in others:
                found = f"{leader!r}, which joint {name!r} should mimic"
                yield Problem.unknown("joint", self.locate(mimic), leader, others, found)

    def settle_shapes(self, meshdir: str, replaced: Collection[str]) -> Iterator[str]:
        """Find every mesh; leave out what is empty, and pictures that cannot be read."""
        problems, pictures, empty = list[Problem](), list[str](), list[str]()
        folders, named = [self.path.parent, self.path.parent / meshdir], set[str | None]()
        for name, link in self.links().items():
            for shown in [*link.findall("visual"), *link.findall("collision")]:
                if shown.get("name") in named:  # MuJoCo would leave it without one, and say so
                    shown.attrib.pop("name", None)
                named.add(shown.get("name"))
                shape = next(iter(shown.findall("geometry/*")), None)
                if shape is not None and shape.tag not in {*_SIZES, "mesh"}:
                    problems.append(
                        self._problem(shape, f"<{shape.tag}> in link {name!r}", f"{', '.join(_SIZES)}, mesh")
                    )
                if shape is None or (shape.tag in _SIZES and self._is_flat(shape)):
                    if shape is not None and shown.tag == "collision":
                        sizes = f"{' and '.join(_SIZES[shape.tag])} above zero [m]"
                        problems.append(self._problem(shape, f"a <{shape.tag}> of link {name!r} without size", sizes))
                    empty.append(f"a {shown.tag} of link {name!r} without size")
                    link.remove(shown)
                elif shape.tag == "mesh":
                    file = shape.get("filename", "")
                    is_solid = shown.tag == "collision" and name not in replaced
                    found = find_mesh(file, f"{self.locate(shape)}: link {name!r}", folders, is_solid=is_solid)
                    if isinstance(found, Path):
                        shape.set("filename", os.fspath(found))
                    elif not is_solid:
                        pictures.append(Path(file).name)
                        link.remove(shown)
                    else:
                        problems.append(found)
        if problems:
            raise DefinitionError(problems)
        yield from empty
        if pictures:
            yield describe_left_out(pictures)

    @staticmethod
    def _is_flat(shape: ElementTree.Element) -> bool:
        return any(not all(_read(shape, name, (0.0,))) for name in _SIZES[shape.tag])

    def give_mass(self) -> Iterator[str]:
        """Mend inertias; a link that a joint moves weighs a gram where it, and all that is fixed to it, are frames."""
        for name, link in self.links().items():
            for inertia in link.iter("inertia"):
                inertia.attrib.update(_PRODUCTS | inertia.attrib)
                if self._has_false_products(inertia):
                    inertia.attrib.update(_PRODUCTS)
                    yield f"link {name!r} has products of inertia as great as its moments: they are left out here"
        moving = {_get(each, "child", "link") for each in self.joints().values() if each.get("type") in _MOVES}
        for name, link in self.links().items():
            if name in moving and not self._has_matter(name):
                inertial = ElementTree.SubElement(link, "inertial")
                ElementTree.SubElement(inertial, "mass", value="0.001")
                ElementTree.SubElement(inertial, "inertia", dict.fromkeys(("ixx", "iyy", "izz"), "1e-6") | _PRODUCTS)
                yield f"link {name!r} is a frame that a joint moves: it weighs a gram here"

    @staticmethod
    def _has_false_products(inertia: ElementTree.Element) -> bool:
        xx, yy, zz, xy, xz, yz = (float(inertia.get(f"i{axes}", 0.0)) for axes in _AXES)
        return bool(np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])[0] <= 0.0 < min(xx, yy, zz))

    def _has_matter(self, name: str) -> bool:
        fixed = [each for each in self.joints().values() if each.get("type") == "fixed"]
        held = [_get(each, "child", "link") for each in fixed if _get(each, "parent", "link") == name]
        return any(self.links()[name].find(tag) is not None for tag in _MATTER) or any(map(self._has_matter, held))

    def release(self) -> Iterator[str]:
        """Let joints turn without end whose limits are equal or not there."""
        for name, joint in self.joints().items():
            limit = joint.find("limit")
            low, high = (limit.get("lower", "0"), limit.get("upper", "0")) if limit is not None else ("0", "0")
            if joint.get("type") == "revolute" and float(low) == float(high):
                joint.set("type", "continuous")
                yield f"joint {name!r} has no range: it turns without end, unless `ranges` of the profile gives one"


def describe_left_out(files: Collection[str]) -> str:
    """What is missing in pictures of the robot, in a line."""
    names = sorted(set(files))
    shown = f"{', '.join(names[:6])}{' ...' if len(names) > 6 else ''}"
    return f"left out of pictures: {shown}, which is absent, torn or of no kind that is read"


def _get(element: ElementTree.Element, tag: str, name: str) -> str:
    found = element.find(tag)
    return found.get(name, "") if found is not None else ""


def _read(element: ElementTree.Element, name: str, default: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(map(float, element.attrib[name].split())) if name in element.attrib else default


def _is_finite(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False
