"""Files of meshes: found by every form of reference, text STL and COLLADA read; no solid is ever left out."""

import importlib.util
import os
import re
from collections.abc import Collection, Iterator
from pathlib import Path
from urllib.parse import unquote

import mujoco
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import DefinitionError, Problem, format_install
from phyagentos.runtime.models.sources import MODELS

UP = 5  # folders above a file, in which the package that it names may stand
READ = frozenset({".stl", ".obj", ".msh"})
COLLADA = ".dae"
Corners = NDArray[np.float64]  # (n, 3), three for each triangle
_HEAD, _RECORD = 84, 50  # bytes of a binary STL: before its triangles, and of each
_VERTEX = re.compile(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)")


def find_mesh(name: str, address: str, folders: list[Path], *, is_solid: bool) -> Path | Problem:
    r"""The file that a model names, or why it cannot be used: absent, with one that is like it, or of another kind.

    Args:
        name: A path, with `/` or `\`, relative to any of `folders`, of which the first is that of the model;
            or `file://`, `package://PACKAGE/`, `model://PACKAGE/`.
        address: Of the problem.
        folders: Where the model looks.
        is_solid: Whether it is one: of pictures none is read in COLLADA, so that all machines see the same.
    """
    places = list(_iter_places(name.replace("\\", "/"), folders))
    is_read = is_solid and importlib.util.find_spec("collada") is not None
    kinds = READ | {COLLADA} if is_read else READ
    for base, rest in places:
        if (base / rest).is_file():
            kind, stem = Path(rest).suffix.lower(), Path(rest).stem
            if (damage := _find_damage(base / rest)) is not None:
                return Problem("UNREADABLE_FILE", address, f"{name!r}, {damage[0]}", "a whole mesh", damage[1])
            if kind in kinds:
                return base / rest
            install = f" {format_install('collada')}" if kind == COLLADA else ""
            hint = f"Convert it, with Blender or `assimp export {Path(rest).name} {stem}.stl`, or use a box.{install}"
            return Problem(
                "MODEL_INVALID",
                address,
                f"{name!r}, which is not read as a solid",
                expected=f"a mesh of the kind {', '.join(sorted(kinds))}",
                hint=hint,
            )
    near = next((like for base, rest in places if (like := _find_like(base, rest))), "")
    hint = f"Did you mean {name[: len(name) - len(near)] + near!r}?" if near else ""
    package = re.match(r"(?:package|model)://([^/]+)", name)
    if package is not None and not near:
        hint = f"Put the folder {package[1]} beside the model, above it, or below that of {MODELS}."
    return Problem("UNREADABLE_FILE", address, f"no file {name!r}", "a mesh at that path from the model", hint)


def _find_damage(file: Path) -> tuple[str, str] | None:
    """Why a file holds no mesh, and what to do: a pointer of Git LFS in its place, nothing, or a torn binary STL."""
    with file.open("rb") as opened:
        head = opened.read(_HEAD)
    size, is_text = file.stat().st_size, head.lstrip().startswith(b"solid")
    if head.startswith(b"version https://git-lfs"):
        return "which is a pointer of Git LFS, not the file", "Bring it: git lfs pull, in the folder of the model."
    is_torn = file.suffix.lower() == ".stl" and not is_text and not _is_whole(head, size)
    return ("which is torn", "Copy or download it anew.") if is_torn or not size else None


def _is_whole(head: bytes, size: int) -> bool:
    """Whether a file of so many bytes is as long as its head (84 bytes of a binary STL) says."""
    return size == _HEAD + _RECORD * int.from_bytes(head[_HEAD - 4 :], "little")


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


def read_corners(file: Path) -> Corners | None:
    """The triangles of an STL in its text form [as it has them], or of a COLLADA file [m]; None for any other file.

    Raises:
        DefinitionError: `MODEL_INVALID` for one that holds no triangles.
    """
    return _read_collada(file) if file.suffix.lower() == COLLADA else _read_text_stl(file)


def _read_collada(file: Path) -> Corners:
    """All meshes of its scene: its unit holds, its `up_axis` does not, as where ROS shows a robot."""
    import collada  # type: ignore[import-not-found, import-untyped, unused-ignore]

    try:
        document = collada.Collada(str(file))
        parts = [part for each in document.scene.objects("geometry") for part in each.primitives()]
        meshes = [part.triangleset() if hasattr(part, "triangleset") else part for part in parts]
        found = [each.vertex[each.vertex_index] for each in meshes if each.vertex_index.shape[1:] == (3,)]  # no lines
        return np.concatenate(found).reshape(-1, 3).astype(float) * (document.assetInfo.unitmeter or 1.0)
    except Exception as error:  # of a file of any content: any
        said = f"a COLLADA file that cannot be read: {error}"
        raise DefinitionError.of("MODEL_INVALID", str(file), said, "a scene with triangles") from error


def _read_text_stl(file: Path) -> Corners | None:
    data = file.read_bytes() if file.suffix.lower() == ".stl" else b""
    if not data.lstrip().startswith(b"solid") or _is_whole(data[:_HEAD], len(data)):
        return None
    try:
        corners = np.array(_VERTEX.findall(data), dtype=float).reshape(-1, 3)
    except ValueError:
        corners = np.empty((0, 3))
    if not len(corners) or len(corners) % 3 or not np.isfinite(corners).all():
        raise DefinitionError.of("MODEL_INVALID", str(file), "a text STL without whole triangles", "three corners each")
    return corners


def settle_meshes(spec: mujoco.MjSpec, path: Path, folders: list[Path], replaced: Collection[str] = ()) -> list[str]:
    """Read text STL and COLLADA, and leave out pictures whose files are absent or of no kind that is read; their names.

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
        shown = [geom for geom in spec.geoms if geom.meshname == mesh.name]
        is_solid = any(
            (geom.contype or geom.conaffinity or geom.name in paired) and geom.parent.name not in replaced
            for geom in shown
        )
        found = find_mesh(str(file), f"{address}: mesh {mesh.name!r}", folders, is_solid=is_solid)
        if isinstance(found, Problem) and inside != file:  # MJCF can ask for files without their folders
            found = next((folder / inside for folder in folders if (folder / inside).is_file()), found)
        if isinstance(found, Path):
            corners = read_corners(found)
            if corners is not None:
                vertices, faces = np.unique(corners, axis=0, return_inverse=True)
                mesh.file, mesh.uservert, mesh.userface = "", vertices.ravel(), faces.ravel()
        elif is_solid:
            problems.append(found)
        else:
            left_out.append(mesh.file)
            for element in [*shown, mesh]:
                spec.delete(element)
    if problems:
        raise DefinitionError(problems)
    return left_out
