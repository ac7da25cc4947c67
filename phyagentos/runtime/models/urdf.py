"""URDF as MuJoCo can read it: files of packages are found, inertias made valid, every link is kept."""

import os
import re
from collections.abc import Collection
from pathlib import Path
from xml.etree import ElementTree

import mujoco

from phyagentos.errors import DefinitionError
from phyagentos.runtime.models.sources import require_reader

_COMPILER = {"balanceinertia": "true", "discardvisual": "false", "fusestatic": "false", "strippath": "false"}
URDF = (".urdf", ".xacro")
_UP = 5  # folders above the file, in which the package that it names may stand
_PACKAGE, _FIND = "package://", re.compile(r"\$\(find (\w+)\)")


def read_urdf(path: Path, replaced: Collection[str] = ()) -> mujoco.MjSpec:
    """Read a URDF file; a visual whose mesh is absent or of no known kind is left out; so is any of `replaced` links.

    Raises:
        DefinitionError: `MODEL_INVALID`, `MODEL_MISSING` for a collision mesh.
    """
    try:
        robot = ElementTree.fromstring(_expand(path) if path.suffix == ".xacro" else path.read_text(encoding="utf-8"))
    except (OSError, ElementTree.ParseError) as error:
        raise DefinitionError.of("MODEL_INVALID", str(path), str(error)) from error
    for element in robot.findall("mujoco"):
        robot.remove(element)
    ElementTree.SubElement(ElementTree.SubElement(robot, "mujoco"), "compiler", _COMPILER)
    for link in robot.findall("link"):
        for shown in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shown.find("geometry/mesh")
            if mesh is None:
                continue
            file = _find_mesh(mesh.attrib["filename"], path)
            if file is not None and file.suffix.lower() in {".stl", ".obj"}:
                mesh.attrib["filename"] = os.fspath(file)
            elif shown.tag == "visual" or link.attrib["name"] in replaced:
                link.remove(shown)
            else:
                found = mesh.attrib["filename"]
                raise DefinitionError.of("MODEL_MISSING", str(path), repr(found), "an STL or OBJ file below its folder")
    try:
        return mujoco.MjSpec.from_string(ElementTree.tostring(robot, encoding="unicode"))
    except ValueError as error:
        raise DefinitionError.of("MODEL_INVALID", str(path), str(error)) from error


def _expand(path: Path) -> str:
    """The URDF that a xacro file stands for; packages that it names are searched among the folders above it."""
    require_reader(path)
    from xacrodoc import XacroDoc, packages  # type: ignore[import-not-found, import-untyped, unused-ignore]

    for name in set(_FIND.findall(path.read_text(encoding="utf-8"))):
        found = [place for folder in path.resolve().parents[:_UP] for place in (folder, folder / name)]
        place = next((each for each in found if each.name == name and each.is_dir()), None)
        if place is not None:
            packages.update_package_cache({name: str(place)})
    return str(XacroDoc.from_file(str(path), resolve_packages=False).to_urdf_string())


def _find_mesh(name: str, path: Path) -> Path | None:
    """A mesh by its path, or by that in a package, which is searched from the file's folder upwards."""
    if not name.startswith(_PACKAGE):
        return found if (found := (path.parent / name)).is_file() else None
    package, _, rest = name.removeprefix(_PACKAGE).partition("/")
    for folder in path.resolve().parents[:_UP]:
        for base in (folder / package, folder):
            if (base / rest).is_file():
                return base / rest
    return None
