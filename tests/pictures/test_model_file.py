"""A compiled model of others is as large as its own bytes."""

import os
import struct

import mujoco
import pytest

from phyagentos.pictures.model_file import ARENA_MAX, HEAD_BYTES, MODEL_MAX, _list_fields, read_model

SCENE = "<mujoco><worldbody><body name='ball'><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"


@pytest.fixture
def stored(tmp_path):
    path = tmp_path / "scene.mjb"
    mujoco.mj_saveModel(mujoco.MjModel.from_xml_string(SCENE), str(path), None)
    return path


def change(path, name, value):
    data = bytearray(path.read_bytes())
    struct.pack_into("<q", data, HEAD_BYTES + 8 * _list_fields()[0].index(name), value)
    path.write_bytes(data)


def test_a_compiled_model_is_read_as_it_was_written(stored):
    model = read_model(stored)
    assert (model.nq, model.body("ball").id) == (7, 1)


@pytest.mark.parametrize("name", ["nq", "nv", "nbody", "nmeshvert", "ntexdata", "nhfielddata", "nmocap", "nnames"])
@pytest.mark.parametrize("value", [2**30, 2**45])
def test_sizes_that_a_file_does_not_hold_are_refused_before_anything_is_reserved(stored, name, value):
    """2**30 joint positions in a file of 9 kB took 16 GB."""
    change(stored, name, value)
    with pytest.raises(ValueError, match=rf"scene.mjb has {stored.stat().st_size} bytes, and arrays that need \d+"):
        read_model(stored)


def test_a_size_below_zero_is_refused(stored):
    change(stored, "nq", -(2**40))
    change(stored, "nv", 2**40)
    with pytest.raises(ValueError, match=r"scene\.mjb"):
        read_model(stored)
    change(stored, "nv", 6)
    with pytest.raises(ValueError, match="failed to load"):
        read_model(stored)


def test_every_size_of_an_array_is_checked(stored, monkeypatch):
    monkeypatch.setattr(mujoco.MjModel, "from_binary_path", lambda *_: pytest.fail("it was loaded"))
    data = stored.read_bytes()
    names, arrays = _list_fields()
    for name in sorted({each for _, extent in arrays for each in extent if each in names}):
        change(stored, name, 2**40)
        with pytest.raises(ValueError, match="and arrays that need"):
            read_model(stored)
        stored.write_bytes(data)


def test_an_arena_beyond_its_limit_a_stub_and_a_fifo_are_refused(stored, tmp_path):
    change(stored, "narena", ARENA_MAX + 1)
    with pytest.raises(ValueError, match=f"reserves {ARENA_MAX + 1} bytes for contacts"):
        read_model(stored)
    (tmp_path / "short.mjb").write_bytes(b"model")
    with pytest.raises(ValueError, match=r"short.mjb has 5 bytes; expected a compiled model"):
        read_model(tmp_path / "short.mjb")
    os.mkfifo(tmp_path / "pipe.mjb")
    with pytest.raises(OSError, match="it is no regular file"):
        read_model(tmp_path / "pipe.mjb")
    with (tmp_path / "long.mjb").open("wb") as file:
        file.truncate(MODEL_MAX + 1)
    with pytest.raises(OSError, match=f"more than {MODEL_MAX} bytes"):
        read_model(tmp_path / "long.mjb")
