"""Compares two evidence bundles bit by bit: whether a rerun did the same.

Files that depend on the wall clock (timings, pictures, fingerprints) are left out on purpose. A file that a clean-up
removed from the recorded bundle is compared by its hash.
"""

import hashlib
from pathlib import Path

import numpy as np

from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence_manifest import read_manifest
from phyagentos.protocol.sessions.looks import LOOKS, PREFIX

_ARRAYS = (evidence.INITIAL, evidence.TERMINAL, evidence.TRAJECTORY)
_TEXTS = (evidence.SCENE_XML, evidence.TRACE, evidence.HOLDS, evidence.EXECUTION)


def find_differences(recorded: Path, repeated: Path) -> list[str]:
    """Where two bundles differ, one sentence each; empty when the session was repeated exactly."""
    differences = [f"{name}: missing" for name in (*_ARRAYS, *_TEXTS) if not (repeated / name).exists()]
    if differences:
        return differences
    manifest = read_manifest(recorded)
    gone = manifest.gone if manifest is not None else {}
    differences += [
        f"{name}: differs from the hash that was kept"
        for name in (*_ARRAYS, *_TEXTS)
        if name in gone and hashlib.sha256((repeated / name).read_bytes()).hexdigest() != gone[name].sha256
    ]
    for name in _ARRAYS:
        if name not in gone:
            differences += _compare_arrays(name, recorded / name, repeated / name)
    is_seen = (recorded / LOOKS).exists() and not any(name.startswith(PREFIX) for name in gone)  # else no first look
    for name in (*_TEXTS, *((LOOKS,) if is_seen else ())):
        if name not in gone and _read(recorded / name) != _read(repeated / name):
            differences.append(f"{name}: differs")
    return differences


def _read(path: Path) -> bytes:
    return path.read_bytes() if path.exists() else b""


def _compare_arrays(name: str, recorded: Path, repeated: Path) -> list[str]:
    with np.load(recorded) as first, np.load(repeated) as second:
        if first.files != second.files:
            return [f"{name}: has {second.files}, recorded were {first.files}"]
        return [
            f"{name}: {key} differs{_describe(first[key], second[key])}"
            for key in first.files
            if first[key].tobytes() != second[key].tobytes()
        ]


def _describe(first: "np.ndarray", second: "np.ndarray") -> str:
    if first.shape != second.shape:
        return f": shape {second.shape}, recorded was {first.shape}"
    return f", by up to {float(np.max(np.abs(first - second))):.3g}"
