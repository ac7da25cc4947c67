"""A detector behind HTTP: an open-vocabulary model on its own server.

`POST <url>` with `{"version": 1, "image_png": <base64>, "labels": ["red cube", ...]}` is answered by
`{"version": 1, "detections": [{"label": "red cube", "score": 0.93, "box": [left, top, width, height],
"mask_png": <base64 of an 8-bit picture of the same size, optional>}]}`. Boxes are in whole pixels.
One malformed detection refuses the whole answer.
"""

import base64
import binascii
import struct
from collections.abc import Mapping, Sequence

import cv2
import msgspec
import numpy as np
from numpy.typing import NDArray

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.network.http import HttpClient
from phyagentos.runtime.perception.detection.detector import Colours, Detection

VERSION = 1
TIMEOUT_S = 5.0
ANSWER_MAX_BYTES = 8 * 2**20  # hundreds of masks of a large picture
DETECTIONS_MAX = 1000
MASKS_MAX_PIXELS = 2**28  # of all masks of an answer together: about 290 of 1280 x 720
_PNG = struct.Struct(">8s4x4sII")  # signature, length of the first chunk, its kind, width and height


class Query(msgspec.Struct, frozen=True, kw_only=True):
    """The request."""

    version: int
    image_png: str
    labels: tuple[str, ...]


class Found(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One detection on the wire."""

    label: str
    score: float
    box: tuple[int, int, int, int]
    mask_png: str | None = None


class Answer(msgspec.Struct, frozen=True, kw_only=True):
    """The response."""

    version: int
    detections: tuple[Found, ...]


class HttpDetector:
    """Client of a model server, whose detections below `score_min` are left out."""

    def __init__(self, url: str, timeout_s: float = TIMEOUT_S, score_min: float = 0.3) -> None:
        self._url, self._timeout_s, self._score_min = url, timeout_s, score_min
        self._client = HttpClient(url, "MODEL_FAILED")

    def detect(self, rgb: Colours, labels: Sequence[str]) -> tuple[Detection, ...]:
        """All matches of the labels, the best first.

        Raises:
            ExecutionError: `MODEL_FAILED`: no answer in time, a status other than 200, or another form.
        """
        _, png = cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
        query = Query(version=VERSION, image_png=base64.b64encode(png.tobytes()).decode(), labels=tuple(labels))
        content = self._client.post(
            msgspec.json.encode(query),
            timeout_s=self._timeout_s,
            max_bytes=ANSWER_MAX_BYTES,
            headers=(("Content-Type", "application/json"),),
        )
        return self._read(content, rgb.shape[:2], labels)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def _read(self, content: bytes, size: tuple[int, ...], labels: Sequence[str]) -> tuple[Detection, ...]:
        try:
            answer = msgspec.json.decode(content, type=Answer)
        except (msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise _malformed(self._url, str(error)) from error
        if answer.version != VERSION or len(answer.detections) > DETECTIONS_MAX:
            raise _malformed(self._url, f"version {answer.version} with {len(answer.detections)} detections")
        masks = sum(each.mask_png is not None for each in answer.detections)
        if masks * size[0] * size[1] > MASKS_MAX_PIXELS:
            raise _malformed(self._url, f"{masks} masks of {size[1]} x {size[0]} pixels")
        found = [self._check(each, size, labels) for each in answer.detections]
        return tuple(sorted((each for each in found if each.score >= self._score_min), key=lambda each: -each.score))

    def _check(self, found: Found, size: tuple[int, ...], labels: Sequence[str]) -> Detection:
        left, top, width, height = found.box
        if found.label not in labels:
            raise _malformed(self._url, f"label {found.label!r}, which was not asked for")
        if not 0.0 <= found.score <= 1.0:
            raise _malformed(self._url, f"a score of {found.score}")
        if min(left, top) < 0 or min(width, height) < 1 or left + width > size[1] or top + height > size[0]:
            raise _malformed(self._url, f"a box {found.box} outside of a picture of {size[1]} x {size[0]} pixels")
        return Detection(
            label=found.label, score=found.score, box=found.box, mask=self._read_mask(found.mask_png, size)
        )

    def _read_mask(self, encoded: str | None, size: tuple[int, ...]) -> NDArray[np.bool_] | None:
        if encoded is None:
            return None
        try:
            data = base64.b64decode(encoded, validate=True)
            head = _PNG.unpack_from(data)  # before it is unpacked: a small file may hold a picture of gigabytes
            is_sized = head == (b"\x89PNG\r\n\x1a\n", b"IHDR", size[1], size[0])
            mask = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_GRAYSCALE) if is_sized else None
        except (binascii.Error, ValueError, struct.error, cv2.error) as error:
            raise _malformed(self._url, f"a mask that is no picture: {error}") from error
        if mask is None or mask.shape != tuple(size):
            raise _malformed(self._url, "a mask that is no picture of the size of the one that was sent")
        return np.asarray(mask > 0)


def open_http_detector(settings: Mapping[str, str | float]) -> HttpDetector:
    """A detector from perception.yaml: `url`, `timeout_s`, `score_min`.

    Raises:
        DefinitionError: `INVALID_VALUE` for missing, unknown or mistyped settings.
    """
    url = settings.get("url")
    unknown = sorted(set(settings) - {"url", "timeout_s", "score_min"})
    numbers = [settings.get("timeout_s", TIMEOUT_S), settings.get("score_min", 0.3)]
    if not isinstance(url, str) or unknown or not all(isinstance(each, float | int) for each in numbers):
        expected = "url: text; timeout_s, score_min: numbers"
        raise DefinitionError.of("INVALID_VALUE", "perception.yaml: detector.settings", repr(dict(settings)), expected)
    return HttpDetector(url, float(numbers[0]), float(numbers[1]))


def _malformed(url: str, what: str) -> ExecutionError:
    return ExecutionError("MODEL_FAILED", f"{url} answered with {what}")
