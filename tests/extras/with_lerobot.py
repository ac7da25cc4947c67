"""Runs a module or a file in the environment of `--lerobot-python`: python with_lerobot.py MODULE|FILE ARGUMENTS.

Where torch came for the CPU and torchvision for CUDA, the operators of torchvision are not there. No test needs them:
they are declared, so that `lerobot` can be imported.
"""

import runpy
import sys

import torch

try:
    import torchvision  # noqa: F401
except RuntimeError:
    for name in [each for each in sys.modules if each.startswith("torchvision")]:
        del sys.modules[name]
    for name in ("nms", "qnms"):
        torch.library.define(f"torchvision::{name}", "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")

del sys.argv[0]
run = runpy.run_path if sys.argv[0].endswith(".py") else runpy.run_module
run(sys.argv[0], run_name="__main__")
