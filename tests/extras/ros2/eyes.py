"""Draws the cameras of a world for its emulator, in the project's own environment: a state in, pictures out.

python eyes.py FOLDER < states > pictures      # both pickled
"""

import json
import pickle
import sys
from pathlib import Path

import mujoco
import numpy as np

from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.runtime.drivers.mujoco.simulated_camera import open_cameras, pose_state


def main(folder):
    about = json.loads((folder / "plant.json").read_text())
    model = mujoco.MjModel.from_binary_path(str(folder / "scene.mjb"))
    cameras = open_cameras(model, read_sensors(Path(about["sensors"])), seed=about["seed"])
    data, rng = mujoco.MjData(model), np.random.default_rng(about["seed"])
    while True:
        try:
            moment_s, qpos = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        state, drawn = pose_state(model, qpos, data), {}
        for name in about["cameras"]:
            frame = cameras[name].capture(state, moment_s, rng)
            lens = [frame.fx, 0.0, frame.cx - 0.5, 0.0, frame.fy, frame.cy - 0.5, 0.0, 0.0, 1.0]  # as ROS counts
            drawn[name] = (np.ascontiguousarray(frame.rgb), np.ascontiguousarray(frame.depth_m), lens)
        pickle.dump(drawn, sys.stdout.buffer)
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
