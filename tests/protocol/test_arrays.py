"""Arrays of the evidence come back bit for bit, and equal ones have equal bytes."""

import io
import zipfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays, floating_dtypes, integer_dtypes

from phyagentos.protocol.workspace.array_files import encode_arrays

ANY = arrays(
    st.one_of(floating_dtypes(endianness="<", sizes=(32, 64)), integer_dtypes(endianness="<")),
    st.one_of(st.just(()), array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=5)),
)


@pytest.mark.slow
@given(st.dictionaries(st.from_regex(r"[a-z]_[a-z]{1,6}", fullmatch=True), ANY, max_size=4))
def test_numpy_reads_back_every_array_bit_for_bit(written):
    with np.load(io.BytesIO(encode_arrays(written))) as read:
        assert read.files == list(written)
        for name, array in written.items():
            assert (read[name].dtype, read[name].shape) == (array.dtype, array.shape)
            assert read[name].tobytes() == array.tobytes()


def test_any_unzip_finds_the_archive_sound_and_the_bytes_tell_no_time():
    first = encode_arrays({"x": np.zeros(3)})
    with zipfile.ZipFile(io.BytesIO(first)) as archive:
        assert archive.testzip() is None
        assert archive.infolist()[0].date_time == (1980, 1, 1, 0, 0, 0)
    assert first == encode_arrays({"x": np.zeros(3)})
