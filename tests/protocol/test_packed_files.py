"""Zip files and NPZ from elsewhere are bounded before they are unpacked."""

import io
import struct
import tracemalloc
import zipfile
import zlib

import numpy as np
import pytest

from phyagentos.protocol.documents import packed_files
from phyagentos.protocol.documents.packed_files import check_picture, open_packed
from phyagentos.protocol.workspace import array_files
from phyagentos.protocol.workspace.array_files import decode_arrays, encode_arrays

LIMIT, BOMB = 1 << 22, 1 << 26  # bytes


def pack(data, *, says=None, how=zipfile.ZIP_DEFLATED, name="x.npy"):
    """A zip file of one member, which may say another size than it has."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", how) as packed, packed.open(name, "w", force_zip64=True) as member:
        for part in data:
            member.write(part)
    packed_bytes = file.getvalue()
    if says is None:
        return packed_bytes
    at = packed_bytes.index(b"PK\x01\x02")  # the size in the central directory
    return packed_bytes[: at + 24] + struct.pack("<I", says) + packed_bytes[at + 28 :]


def write_npy(shape, dtype="<f8", data=b""):
    header = str({"descr": dtype, "fortran_order": False, "shape": shape}).encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header) + 1) + header + b"\n" + data


def zeros(n_bytes):
    return (bytes(1 << 20) for _ in range(n_bytes >> 20))


def pack_many(end=b""):
    """Members without bytes, whose list takes more than is read; `end` stands before the end of the file."""
    entry = b"PK\x01\x02" + bytes(24) + struct.pack("<H", 1) + bytes(16) + b"x"
    file = entry * (packed_files.LIST_MAX // len(entry) + 1)
    counts = (0, 0, 0, 0, 0 if end else len(file), 0, 0)
    return file + end + b"PK\x05\x06" + struct.pack("<HHHHIIH", *counts)


HOSTILE = {
    "members without end": (pack_many, "its list of members has more than"),
    "members whose number another record says": (lambda: pack_many(b"PK\x06\x07" + bytes(16)), "its list of members"),
    "a member that unpacks to more than is read": (lambda: pack(zeros(BOMB)), "unpacks to"),
    "one that says that it is small": (lambda: pack(zeros(BOMB), says=100), "unpacked"),
    "one packed by another method": (lambda: pack(zeros(BOMB), how=zipfile.ZIP_BZIP2, says=100), "method 12"),
    "an array larger than its bytes": (lambda: pack([write_npy((1 << 34,))]), "an array of shape"),
    "a negative shape": (lambda: pack([write_npy((-1, -1), data=bytes(8))]), ""),
    "items of no size": (lambda: pack([write_npy((1 << 60,), "<U0")]), "an array of shape"),
    "objects": (lambda: pack([write_npy((1,), "|O", b"cos\nsystem\n(S'true'\ntR.")]), ""),
    "no array": (lambda: pack([b"hello"]), ""),
    "no zip file": (lambda: b"hello", ""),
    "nothing": (lambda: b"", ""),
}


@pytest.fixture(autouse=True)
def _small_bounds(monkeypatch):
    for module in (packed_files, array_files):
        monkeypatch.setattr(module, "MEMBER_MAX", LIMIT)


@pytest.mark.parametrize(("make", "problem"), HOSTILE.values(), ids=HOSTILE)
def test_arrays_of_others_are_refused_before_they_take_memory(make, problem):
    data = make()
    tracemalloc.start()
    with pytest.raises(ValueError, match=f"no NPZ.*{problem}"):
        decode_arrays(data)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 * LIMIT


def test_several_members_count_together():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as packed:
        for name in ("a.npy", "b.npy", "c.npy"):
            with packed.open(name, "w") as member:
                member.write(write_npy((LIMIT // 2,), "|u1"))
                for part in zeros(LIMIT // 2):
                    member.write(part)
    with pytest.raises(ValueError, match="more than"):
        decode_arrays(file.getvalue())


def test_arrays_come_back_as_they_were():
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.zeros(0), "c": np.array(3), "d": np.array(["x", "yy"])}
    read = decode_arrays(encode_arrays(arrays))
    assert [*read] == [*arrays]
    assert all(
        read[name].tobytes() == each.tobytes() and read[name].shape == each.shape for name, each in arrays.items()
    )


def test_a_packed_file_says_what_is_wrong_with_a_member(tmp_path):
    path = tmp_path / "look.zip"
    path.write_bytes(pack(zeros(BOMB), name="look.json"))
    with open_packed(path) as file, pytest.raises(ValueError, match=f"unpacks to {BOMB} bytes; at most"):
        file.read("look.json")


def test_a_picture_of_a_million_columns_is_not_decoded():
    header = struct.pack(">IIBBBBB", 1_000_000, 1_000_000, 8, 2, 0, 0, 0)
    chunk = struct.pack(">I", 13) + b"IHDR" + header + struct.pack(">I", zlib.crc32(b"IHDR" + header))
    with pytest.raises(ValueError, match="pixels"):
        check_picture(b"\x89PNG\r\n\x1a\n" + chunk)
