"""Pictures as a film: MP4, H.264."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import needs_extra

X264 = {"crf": "20", "threads": "1"}  # hardly to be distinguished from the pictures; the same bytes each time


def write_mp4(pictures: Iterable[NDArray[np.uint8]], to: Path, fps: int, options: Mapping[str, str] = X264) -> None:
    """Write pictures (height, width, 3) of one size, without an odd last row or column; raises `EXTRA_MISSING`."""
    with needs_extra("export", "paos export video"):
        import av
    to.touch()  # an OSError that names the file where it cannot be written
    with av.open(to, "w") as container:
        stream = container.add_stream("libx264", rate=fps, options=dict(options))
        stream.pix_fmt = "yuv420p"
        for rgb in pictures:
            even = np.ascontiguousarray(rgb[: len(rgb) // 2 * 2, : rgb.shape[1] // 2 * 2])
            if not stream.codec_context.is_open:
                stream.height, stream.width = even.shape[:2]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(even, format="rgb24")))
        container.mux(stream.encode())
