"""A slide with an object on it, served from any Python that has `websockets` and `msgpack`.

python slide.py --port 7000 < KEY
"""

import json
import sys

from target_server.body import Body, Entity, Joint, State
from target_server.server import main
from target_server.wire import Refusal


class Slide(Body):
    """It stands at once where a row of set-points puts it, as a stepper motor does within its limits."""

    target = "counter"
    driver = "slide"
    joints = (Joint("slide", low=-1.0, high=1000.0, velocity=10.0, axis=(0.0, 0.0, 1.0)),)
    step_s = 0.02
    observations = ("joint_state", "entity_poses")
    end_effector = "opening"
    width_max_m = 0.1
    has_truth = True

    def __init__(self):
        self._steps, self._q, self._qd, self._width_m = 0, 0.0, 0.0, 0.1
        self._emergency_stops = 0
        self.tools = {"modules": self.list_modules, "emergency_stops": self.count_emergency_stops}

    @property
    def time_s(self):
        return self._steps * self.step_s

    def load(self, scene, seed, snapshot):
        state = (0, 0.0, 0.1)
        if snapshot:
            try:
                steps, q, width_m = json.loads(snapshot)
                state = (int(steps), float(q), float(width_m))
            except ValueError as error:
                raise Refusal("MALFORMED", f"no snapshot of a slide: {error}") from error
        (self._steps, self._q, self._width_m), self._qd = state, 0.0

    def read(self):
        return State(q=(self._q,), qd=(self._qd,), tcp_m=(0.0, 0.0, self._q), width_m=self._width_m)

    def list_entities(self):
        shape = {"kind": "sphere", "size_m": (0.01,), "pose": {}}
        return (Entity("mark", "mark", position_m=(0.0, 0.0, self._q), shapes=(shape,)),)

    def step(self, q, qd, width_m):
        (self._q,), (self._qd,), self._width_m = q, qd, width_m
        self._steps += 1
        return ""

    def stay(self):
        self._steps, self._qd = self._steps + 1, 0.0

    def halt(self, category):
        self.stay()

    def emergency_stop(self):
        self._emergency_stops += 1  # a device presses its own stop here
        self.halt(1)

    def snapshot(self):
        return "application/json", json.dumps((self._steps, self._q, self._width_m)).encode()

    def list_modules(self, _arguments):
        """Tool: what this process has loaded."""
        return {"modules.txt": ("text/plain", "\n".join(sys.modules).encode())}

    def count_emergency_stops(self, _arguments):
        """Tool: how many emergency stops it has heard of."""
        return {"count.txt": ("text/plain", str(self._emergency_stops).encode())}


if __name__ == "__main__":
    main(Slide)
