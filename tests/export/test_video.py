"""Films as MP4: PyAV reads back the pictures that were written."""

import sys

import numpy as np
import pytest

from phyagentos.errors import DefinitionError
from phyagentos.export.video import write_mp4

av = pytest.importorskip("av", reason="needs the extra `export`: pip install '.[export]'")


def test_a_film_has_every_picture_at_its_rate_without_an_odd_last_row_or_column(tmp_path):
    shades = np.linspace(20, 230, 30)
    pictures = [np.full((61, 81, 3), shade, np.uint8) for shade in shades]

    write_mp4(iter(pictures), tmp_path / "film.mp4", 25)

    with av.open(tmp_path / "film.mp4") as film:
        (stream,) = film.streams
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
        assert (stream.codec_context.name, stream.average_rate) == ("h264", 25)
    assert len(frames) == 30
    assert {frame.shape for frame in frames} == {(60, 80, 3)}
    assert np.abs([frame.mean() - shade for frame, shade in zip(frames, shades, strict=True)]).max() < 4


def test_a_place_that_cannot_be_written_is_named_before_a_picture_is_drawn(tmp_path):
    def draw():
        raise AssertionError
        yield

    with pytest.raises(FileNotFoundError) as refused:
        write_mp4(draw(), tmp_path / "missing" / "film.mp4", 25)
    assert refused.value.filename == str(tmp_path / "missing" / "film.mp4")


def test_without_pyav_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)

    with pytest.raises(DefinitionError, match=r"paos export video: EXTRA_MISSING.*pip install '\.\[export\]'"):
        write_mp4([], tmp_path / "film.mp4", 25)
    assert not (tmp_path / "film.mp4").exists()
