"""Keeps what cameras show during a session, at the rate of runtime_contract.yaml; the pictures decide nothing.

The frames are requested behind a command, so that the world never stands for them. Their noise follows from the
exposure alone: a session that is recorded has the bits of one that is not.
"""

import io
import zipfile

import msgspec

from phyagentos.protocol.sessions.recording import INDEX, RecordedPicture, Recording
from phyagentos.runtime.perception.look_file import encode_picture
from phyagentos.runtime.targets.wire import Capture, Frames


class CameraRecorder:
    """The pictures of one session, of cameras of sensors.yaml, kept at a rate in simulated time [Hz]."""

    def __init__(self, cameras: tuple[str, ...], rate_hz: float, control_period_s: float) -> None:
        self.request = Capture(cameras=cameras)
        self._rate_hz, self._every = rate_hz, max(1, round(1.0 / (rate_hz * control_period_s)))
        self._pictures: list[RecordedPicture] = []
        self._data: list[bytes] = []

    def is_due(self, ticks: int) -> bool:
        """Whether the end of this control period, counted from 1, is shown."""
        return (ticks - 1) % self._every == 0

    def keep(self, shown_s: float, frames: Frames) -> None:
        """Keep the frames that the cameras show at a moment [s]; a camera without one leaves a gap."""
        for frame in frames.frames:
            picture = RecordedPicture(
                camera=frame.camera,
                shown_s=shown_s,
                time_s=frame.time_s,
                rgb=f"{frame.camera}-{len(self._data):05d}.png",
            )
            self._pictures.append(picture)
            self._data.append(encode_picture(frame.rgb))

    def encode(self) -> bytes:
        """The bytes of `recording.zip`; empty without a picture. They depend on the pictures alone."""
        if not self._pictures:
            return b""
        buffer, index = io.BytesIO(), Recording(rate_hz=self._rate_hz, pictures=tuple(self._pictures))
        with zipfile.ZipFile(buffer, "w") as file:
            file.writestr(zipfile.ZipInfo(INDEX), msgspec.json.encode(index))
            for picture, data in zip(self._pictures, self._data, strict=True):
                file.writestr(zipfile.ZipInfo(picture.rgb), data)
        return buffer.getvalue()
