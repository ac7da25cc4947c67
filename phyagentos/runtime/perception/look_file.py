"""A look as one zip file: pictures as PNG, depths as `.npy`, the rest as JSON that names them; lossless.

The bytes depend on the look alone.
"""

import hashlib
import io
import zipfile
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents.packed_files import PackedFile, check_picture, open_packed
from phyagentos.protocol.sessions.looks import LOOK, PREFIX, read_stored_look
from phyagentos.protocol.workspace.array_files import decode_array
from phyagentos.runtime.perception.look import Look

_LEVEL = 1  # of deflate: more costs three times the time for a tenth of the size


def write_look(look: Look, folder: Path) -> tuple[str, str]:
    """Write a look into a bundle, or link it from the bundle that has it; it remembers its path.

    Returns:
        Name of the file and SHA-256 of its bytes.
    """
    known = Path(look.file)
    if not look.file:
        data = _encode(look)
        look.sha256 = hashlib.sha256(data).hexdigest()
        path = folder / f"{PREFIX}{look.sha256[:16]}.zip"
        path.write_bytes(data)
        look.file = str(path)
    elif not (path := folder / known.name).exists():
        try:
            path.hardlink_to(known)
        except OSError:  # it was pruned, lies on another disk, or has too many links
            path.write_bytes(_encode(look))
    return path.name, look.sha256


def read_look(path: Path, sha256: str) -> Look:
    """A look as recorded; raises ExecutionError `EVIDENCE_DAMAGED`, which name the file."""
    read_stored_look(path, sha256)
    with open_packed(path) as file:
        try:
            look = msgspec.json.decode(file.read(LOOK), type=Look, dec_hook=lambda _, name: read_array(file, name))
        except (msgspec.MsgspecError, KeyError, ValueError) as error:
            raise ExecutionError("EVIDENCE_DAMAGED", f"{path}: {error}") from error
    look.file, look.sha256 = str(path), sha256
    return look


def encode_pictures(look: Look) -> dict[str, bytes]:
    """The whole pictures of a look as PNG, by camera."""
    whole = (frame for asked, given in look.captures if not asked.crops for frame in given.frames)
    return {frame.camera: encode_picture(frame.rgb) for frame in whole}


def encode_picture(rgb: NDArray[Any]) -> bytes:
    """A picture (height, width, 3), uint8, as PNG."""
    return cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))[1].tobytes()


def write_array(file: zipfile.ZipFile, name: str, array: NDArray[Any]) -> str:
    """Put an array into a zip file, a picture as PNG and any other one as `.npy`; its name there."""
    if array.dtype == np.uint8 and array.ndim == 3 and array.shape[2] == 3:
        file.writestr(zipfile.ZipInfo(f"{name}.png"), encode_picture(array))
        return f"{name}.png"
    data = io.BytesIO()
    np.save(data, array)
    file.writestr(zipfile.ZipInfo(f"{name}.npy"), data.getvalue(), zipfile.ZIP_DEFLATED, _LEVEL)
    return f"{name}.npy"


def read_array(file: PackedFile, name: str) -> NDArray[Any]:
    """An array of a zip file by its name there; raises ValueError where it is none, KeyError without one."""
    data = file.read(name)
    if name.endswith(".npy"):
        return decode_array(data)
    decoded = cv2.imdecode(np.frombuffer(check_picture(data), np.uint8), cv2.IMREAD_COLOR)
    if decoded is None:
        raise ValueError(f"{name} is no PNG")
    return np.ascontiguousarray(decoded[..., ::-1])


def _encode(look: Look) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:

        def keep(array: NDArray[Any]) -> str:
            return write_array(file, f"{len(file.namelist()):02d}", array)

        blank = msgspec.structs.replace(look, file="", sha256="")
        file.writestr(zipfile.ZipInfo(LOOK), msgspec.json.encode(blank, enc_hook=keep), zipfile.ZIP_DEFLATED, _LEVEL)
    return buffer.getvalue()
