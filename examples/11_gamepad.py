"""11. A gamepad moves the tool of an arm that is taken over. Run me: python examples/11_gamepad.py"""

import struct
import threading
from typing import BinaryIO

import numpy as np

from phyagentos.policies import Array, Infer, PolicyDescriptor, Start, serve_policy

EVENT = struct.Struct("<IhBB")  # of Linux: time [ms], value, kind, number
BUTTON, AXIS, FULL, DEAD = 1, 2, 32767, 0.15
STICKS = {1: (0, -0.06), 0: (1, -0.06), 4: (2, -0.06), 3: (5, -0.3)}  # axis of the tool, way of a full stick [m, rad]
GRIPPER, BACK = 0, 7  # buttons
ROWS = 12  # a tenth of a second each


class Gamepad:
    """Sticks are ways of the tool, each begun and ended at rest; one button moves the gripper, one hands back."""

    def __init__(self, device: BinaryIO, opening_m: float) -> None:
        self._device, self._opening_m, self._width_m = device, opening_m, -1.0
        self._way, self._is_over = np.zeros(6), False

    def listen(self) -> None:
        """Read events until the device is gone, which hands the arm back."""
        while len(event := self._device.read(EVENT.size)) == EVENT.size:
            _, value, kind, number = EVENT.unpack(event)
            if kind == AXIS and number in STICKS:
                axis, full = STICKS[number]
                self._way[axis] = full * value / FULL if abs(value) > DEAD * FULL else 0.0
            elif kind == BUTTON and value and number == GRIPPER:
                self._width_m = 0.0 if self._width_m > self._opening_m / 2 else self._opening_m
            self._is_over |= kind == BUTTON and bool(value) and number == BACK
        self._is_over = True

    def start(self, request: Start) -> None: ...

    def infer(self, request: Infer) -> tuple[Array, bool]:
        if self._width_m < 0.0:
            self._width_m = float(request.observations["gripper_width"])
        share = np.linspace(0.0, 1.0, ROWS + 1 if self._way.any() else 2)
        rows = np.outer(np.diff(share**3 * (10.0 - 15.0 * share + 6.0 * share**2)), self._way)
        return np.column_stack((rows, np.full(len(rows), self._width_m))), self._is_over


if __name__ == "__main__":
    import io
    import sys
    from pathlib import Path

    if "--serve" in sys.argv:  # then /dev/input/js0; paos take-over SESSION --leader tcp://127.0.0.1:5555
        with Path(sys.argv[-1]).open("rb", buffering=0) as device:
            pad = Gamepad(device, opening_m=0.08)
            threading.Thread(target=pad.listen, daemon=True).start()
            facts = {"policy": "gamepad/1", "endpoint": "tcp://127.0.0.1:5555", "observations": {}, "inference_s": 1.0}
            serve_policy(pad, PolicyDescriptor.model_validate(facts))
    pushed = io.BytesIO(EVENT.pack(0, -FULL, AXIS, 1) + EVENT.pack(5, 1, BUTTON, GRIPPER))
    pad = Gamepad(pushed, opening_m=0.08)
    pad.listen()
    seen = {"gripper_width": np.array(0.08)}
    rows, is_over = pad.infer(Infer(session="g.a", sequence=0, rows_done=0, time_s=0.0, observations=seen))
    print(f"{len(rows)} rows, {rows[:, 0].sum():.2f} m away, opening {rows[-1, 6]:.2f} m, handed back: {is_over}")
