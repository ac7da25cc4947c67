"""Observations as a model takes them: its own names, sizes of pictures, forms of rotations. The paper's PolicyAdapter.

Evidence keeps what was measured, so that it can be shown to a model of other inputs.
"""

from collections.abc import Mapping
from typing import Any

import cv2
import msgspec
import numpy as np
import scipy
from numpy.typing import NDArray

from phyagentos.protocol.capabilities.action_spaces import POSITION_WIDTH, ActionSpace
from phyagentos.protocol.capabilities.policy_descriptors import Stream
from phyagentos.runtime.actions.bridges.rotations import encode_rotation
from phyagentos.runtime.policies import wire

Array = NDArray[Any]


def arrange(request: wire.Infer, streams: Mapping[str, Stream]) -> wire.Infer:
    """The request with its observations by the model's keys; streams of one key are flattened and joined."""
    parts: dict[str, list[Array]] = {}
    for name, value in request.observations.items():
        stream = streams[name]
        parts.setdefault(stream.key or name, []).append(_shape(value, stream))
    joined = {
        key: arrays[0] if len(arrays) == 1 else np.concatenate([np.atleast_1d(each) for each in arrays], axis=-1)
        for key, arrays in parts.items()
    }
    return msgspec.structs.replace(request, observations=joined)


def _shape(value: Array, stream: Stream) -> Array:
    if stream.modality in {"rgb", "depth"}:
        pictures = value if stream.history > 1 else value[None]  # (history, height, width, ...)
        shown = np.stack([_fit(each, stream) for each in pictures])
        return shown if stream.history > 1 else shown[0]
    if stream.rotation != "quaternion_wxyz":
        space = ActionSpace(representation="tool_pose", rotation=stream.rotation, euler_order="xyz", rate_hz=1.0)
        poses = value.reshape(-1, value.shape[-1])
        turns = encode_rotation(scipy.spatial.transform.Rotation.from_quat(poses[:, [4, 5, 6, 3]]), space)
        pose = np.concatenate((poses[:, :POSITION_WIDTH], turns), axis=1).astype(value.dtype)
        return pose.reshape((*value.shape[:-1], -1))
    return value


def _fit(picture: Array, stream: Stream) -> Array:
    """A picture within `resize`, its proportions kept; the mean of two depths would be none."""
    if stream.turned:
        picture = picture[::-1, ::-1]
    if stream.resize is None or picture.shape[:2] == stream.resize:
        return np.ascontiguousarray(picture)
    height, width = stream.resize
    ratio = max(picture.shape[0] / height, picture.shape[1] / width)
    inner = max(1, int(picture.shape[1] / ratio)), max(1, int(picture.shape[0] / ratio))
    small = cv2.resize(
        np.ascontiguousarray(picture),
        inner,
        interpolation=cv2.INTER_NEAREST if stream.modality == "depth" else cv2.INTER_LINEAR,
    )
    top, left = (height - inner[1]) // 2, (width - inner[0]) // 2
    black = top, height - inner[1] - top, left, width - inner[0] - left
    return cv2.copyMakeBorder(small, *black, cv2.BORDER_CONSTANT, value=0)
