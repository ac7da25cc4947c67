"""Pictures of cameras at a rate, in an evidence bundle: `recording.zip`, made where runtime_contract.yaml asks for it.

The file is readable without this package: a PNG for each picture, and `recording.json`, which says what each shows.
"""

from pathlib import Path

import msgspec

from phyagentos.errors import ExecutionError
from phyagentos.protocol.documents.packed_files import open_packed

RECORDING = "recording.zip"
INDEX = "recording.json"  # within that file
FORMAT = "recording/1"


class RecordedPicture(msgspec.Struct, frozen=True, kw_only=True):
    """One picture, without loss.

    Attributes:
        camera: Name of sensors.yaml.
        shown_s: When it was the latest that the camera could show, in the target's time [s].
        time_s: Stamp of the sensor [s]; earlier by the camera's latency, and by frames that were lost.
        rgb: Name of the PNG in the file.
    """

    camera: str
    shown_s: float
    time_s: float
    rgb: str


class Recording(msgspec.Struct, frozen=True, kw_only=True):
    """`recording.json`: the pictures in the order of time, at the declared rate [Hz]."""

    phy: str = FORMAT
    rate_hz: float
    pictures: tuple[RecordedPicture, ...]


def read_recording(folder: Path) -> Recording | None:
    """What a bundle holds of its cameras; None where nothing was recorded, or a clean-up took it out.

    Raises:
        ExecutionError: `EVIDENCE_DAMAGED`, which names the file.
    """
    path = folder / RECORDING
    try:
        with open_packed(path) as file:
            return msgspec.json.decode(file.read(INDEX), type=Recording)
    except FileNotFoundError:
        return None
    except (KeyError, ValueError, msgspec.MsgspecError, OSError) as error:
        raise ExecutionError("EVIDENCE_DAMAGED", f"{path}: {error}") from error
