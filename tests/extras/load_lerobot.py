"""Loads a data set with the package `lerobot` and prints what it holds; runs in the environment of `--lerobot-python`.

    python load_lerobot.py FOLDER

Where torch came for the CPU and torchvision for CUDA, the operators of torchvision are not there. Reading needs none:
they are declared, so that the package can be imported.
"""

import json
import sys

import torch

try:
    import torchvision  # noqa: F401
except RuntimeError:
    for name in [each for each in sys.modules if each.startswith("torchvision")]:
        del sys.modules[name]
    for name in ("nms", "qnms"):
        torch.library.define(f"torchvision::{name}", "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")

from lerobot.datasets.lerobot_dataset import LeRobotDataset

ROWS = 10
given = sys.argv[1]
BACKEND = "pyav"  # brings FFmpeg along; that of torchcodec is of the system
fps = LeRobotDataset("paos/verified", root=given, video_backend=BACKEND).fps
data = LeRobotDataset(
    "paos/verified", root=given, video_backend=BACKEND, delta_timestamps={"action": [k / fps for k in range(ROWS)]}
)
frame, last = data[0], data[len(data) - 1]
forms = {name: list(value.shape) for name, value in frame.items() if hasattr(value, "shape")}
pictures = {key: [float(each[key].mean()) for each in (frame, last)] for key in data.meta.video_keys}
sys.stdout.write(
    json.dumps(
        {
            "episodes": data.num_episodes,
            "frames": data.num_frames,
            "fps": data.fps,
            "task": frame["task"],
            "forms": forms,
            "pictures": pictures,
            "first_state": frame["observation.state"].tolist(),
            "origins": {
                key: list(data.meta.episodes[key])
                for key in ("session_id", "verdict", "action")
                if key in data.meta.episodes.column_names
            },
            "stats": sorted(data.meta.stats),
        }
    )
)
