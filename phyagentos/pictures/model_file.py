"""The compiled scene of a bundle, which others may have written: no larger than its own bytes.

MuJoCo reserves what the head of a file demands before it reads on: 800 bytes may demand 16 GB. A file holds every
array of a model, so one that holds fewer bytes than its arrays need is refused before it is loaded.
"""

import math
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from phyagentos.protocol.documents.regular_files import read_regular

MODEL_MAX = 1 << 27  # bytes of a file: as of a message of a target; a humanoid has 80 MiB
ARENA_MAX = 1 << 32  # bytes that a model may reserve for its contacts; no file holds them
ALIGNED_BYTES = 64  # each array begins at a multiple of these in memory
HEAD_BYTES = 20  # five numbers, before the sizes
WIDTHS = {"mjtNum *": 8, "mjtSize *": 8, "int *": 4, "float *": 4}  # of others, one byte


def read_model(path: Path) -> mujoco.MjModel:
    """A compiled model; raises OSError, or ValueError for other bytes and for sizes that the file does not hold."""
    data = read_regular(path, MODEL_MAX)
    names, arrays = _list_fields()
    if len(data) < HEAD_BYTES + 8 * len(names):
        raise ValueError(f"{path.name} has {len(data)} bytes; expected a compiled model")
    sizes = dict(zip(names, np.frombuffer(data, np.int64, len(names), HEAD_BYTES).tolist(), strict=True))
    counts = sizes | {each: int(each) for each in "23456789"}  # constants by name are counted as one
    needed = sum(width * math.prod(counts.get(each, 1) for each in extent) for width, extent in arrays)
    if not 0 <= (arena := sizes.pop("narena")) <= ARENA_MAX:
        raise ValueError(f"{path.name} reserves {arena} bytes for contacts; at most {ARENA_MAX} are read")
    if max(needed, *sizes.values()) > len(data) + ALIGNED_BYTES * len(arrays):  # below zero MuJoCo refuses them itself
        raise ValueError(f"{path.name} has {len(data)} bytes, and arrays that need {needed}")
    return mujoco.MjModel.from_binary_path(path.name, {path.name: data})


@cache
def _list_fields() -> tuple[tuple[str, ...], tuple[tuple[int, tuple[str, ...]], ...]]:
    """Names of the sizes in the order of a file, and of each array the bytes of an element and its sizes' names."""
    from mujoco.introspect import structs  # slow, and only files of others need it

    fields = structs.STRUCTS["mjModel"].fields
    names = tuple(each.name for each in fields if str(each.type) == "mjtSize")
    arrays = ((each.type, each.array_extent) for each in fields if getattr(each, "array_extent", None))
    return names, tuple((WIDTHS.get(str(kind), 1), tuple("*".join(map(str, of)).split("*"))) for kind, of in arrays)
