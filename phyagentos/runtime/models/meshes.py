"""Files of meshes: found by every form of reference, text STL read; a solid that is absent is never left out."""

import os
import re
from collections.abc import Collection, Iterator
from pathlib import Path
from urllib.parse import unquote

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import DefinitionError, Problem
from phyagentos.runtime.models.sources import MODELS

UP = 5  # folders above a file, in which the package that it names may stand
READ = frozenset({".stl", ".obj", ".msh"})
_HEAD, _RECORD = 84, 50  # bytes of a binary STL: before its triangles, and of each
_VERTEX = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")


def find_mesh(name: str, address: str, folders: list[Path], kinds: frozenset[str] = READ) -> Path | Problem:
    r"""The file that a model names, or why it cannot be used: absent, with one that is like it, or of another kind.

    Args:
        name: A path, with `/` or `\`, relative to any of `folders`, of which the first is that of the model;
            or `file://`, `package://PACKAGE/`, `model://PACKAGE/`.
        address: Of the problem.
        folders: Where the model looks.
        kinds: Suffixes of files that are read.
    """
    places = list(_iter_places(name.replace("\\", "/"), folders))
    for base, rest in places:
        if (base / rest).is_file():
            if Path(rest).suffix.lower() in kinds:
                return base / rest
            stem = Path(rest).stem
            hint = (
                f"Convert it, with Blender or `assimp export {Path(rest).name} {stem}.stl`, or use a box or cylinder."
            )
            expected = f"a mesh of the kind {', '.join(sorted(kinds))}"
            return Problem("MODEL_INVALID", address, f"{name!r}, which is not read as a solid", expected, hint)
    near = next((like for base, rest in places if (like := _find_like(base, rest))), "")
    hint = f"Did you mean {name[: len(name) - len(near)] + near!r}?" if near else ""
    return Problem("UNREADABLE_FILE", address, f"no file {name!r}", "a mesh at that path from the model", hint)


def _iter_places(name: str, folders: list[Path]) -> Iterator[tuple[Path, str]]:
    """Folders, and the path below each at which the file may be."""
    scheme, has_scheme, rest = name.partition("://")
    if not has_scheme:
        yield from ((folder, name) for folder in folders)
    elif scheme == "file":
        path = Path(unquote(rest).lstrip("/"))
        yield Path("/"), str(path)
        yield from ((folders[0], str(Path(*path.parts[k:]))) for k in range(len(path.parts) - 1))  # of another machine
    elif scheme in {"package", "model"}:
        package, _, below = rest.partition("/")
        yield from ((folder, below) for folder in iter_package_folders(folders[0], package))


def iter_package_folders(folder: Path, package: str) -> Iterator[Path]:
    """Where a package may be that a file in `folder` names: upwards from there, then in the folder of models."""
    models = [Path(os.environ[MODELS])] if os.environ.get(MODELS) else []
    for each in [*[folder.resolve(), *folder.resolve().parents][:UP], *models]:
        yield from (each / package, each)


def _find_like(base: Path, name: str) -> str:
    """The path of a file that differs in case or suffix alone; empty without one."""
    at = base
    for part in name.split("/"):
        inside = sorted(each.name for each in at.iterdir()) if at.is_dir() else []
        same = [each for each in inside if each.lower() == part.lower()]
        like = [each for each in inside if Path(each).stem.lower() == Path(part).stem.lower()]
        found = part if part in {".", "..", *inside} else next(iter(same or like), None)
        if found is None:
            return ""
        at = at / found
    return str(at.relative_to(base)) if at.is_file() else ""


def read_text_stl(file: Path) -> NDArray[np.float64] | None:
    """(n, 3) corners, three for each triangle, of an STL in its text form; None for any other file.

    Raises:
        DefinitionError: `MODEL_INVALID` for a text that holds no triangles.
    """
    data = file.read_bytes() if file.suffix.lower() == ".stl" else b""
    count = int.from_bytes(data[_HEAD - 4 : _HEAD], "little")
    if not data.lstrip().startswith(b"solid") or len(data) == _HEAD + count * _RECORD:
        return None
    try:
        corners = np.array(_VERTEX.findall(data), dtype=float).reshape(-1, 3)
    except ValueError:
        corners = np.empty((0, 3))
    if not len(corners) or len(corners) % 3 or not np.isfinite(corners).all():
        raise DefinitionError.of("MODEL_INVALID", str(file), "a text STL without whole triangles", "three corners each")
    return corners


def settle_meshes(spec: mujoco.MjSpec, path: Path, folders: list[Path], replaced: Collection[str] = ()) -> list[str]:
    """Read text STL, and leave out pictures whose files are absent or of no kind that is read; their names.

    Raises:
        DefinitionError: `UNREADABLE_FILE`, `MODEL_INVALID` for every such file of a solid.
    """
    problems: list[Problem] = []
    left_out: list[str] = []
    paired = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    for mesh in [each for each in spec.meshes if each.file]:
        line = mesh.info.removeprefix("line ")
        address = f"{path}:{line}" if line.isdecimal() and line != "0" else str(path)
        file, inside = Path(mesh.compiler.meshdir) / mesh.file, Path(mesh.compiler.meshdir) / Path(mesh.file).name
        found = find_mesh(str(file), f"{address}: mesh {mesh.name!r}", folders)
        if isinstance(found, Problem) and inside != file:  # MJCF can ask for files without their folders
            found = next((folder / inside for folder in folders if (folder / inside).is_file()), found)
        shown = [geom for geom in spec.geoms if geom.meshname == mesh.name]
        if isinstance(found, Path):
            corners = read_text_stl(found)
            if corners is not None:
                vertices, faces = np.unique(corners, axis=0, return_inverse=True)
                mesh.file, mesh.uservert, mesh.userface = "", vertices.ravel(), faces.ravel()
        elif any(
            (geom.contype or geom.conaffinity or geom.name in paired) and geom.parent.name not in replaced
            for geom in shown
        ):
            problems.append(found)
        else:
            left_out.append(mesh.file)
            for element in [*shown, mesh]:
                spec.delete(element)
    if problems:
        raise DefinitionError(problems)
    return left_out
