"""What a joint_trajectory_controller does with messages of its topic, without ROS: which it refuses, where it goes.

Written from the documentation of ros2_controllers. Splines: linear without velocities (or
where they are ignored), cubic with; a trajectory begins
at the measured state, or at the desired one with `interpolate_from_desired_state`.
"""

from collections import Counter

import numpy as np

TOLERANCE_RAD = 0.3  # of the path; beyond it the controller holds


class TrajectoryController:
    def __init__(self, joints, q, *, allows_end_velocity=False, begins_at_desired=False, ignores_velocities=False):
        self.joints, self._allows, self._begins_at_desired = list(joints), allows_end_velocity, begins_at_desired
        self._is_linear = ignores_velocities
        self.desired, self.velocity = np.array(q, dtype=float), np.zeros(len(q))
        self.counts = Counter()
        self._points = []  # (moment, q, qd or None), the first is where it began

    def hold(self):
        self._points, self.velocity = [], np.zeros_like(self.desired)

    def take(self, names, points, start_s, now_s, measured):
        """One message: points as (after_s, q, qd); a start of 0 is now."""
        why = self._refuse(names, points, start_s, now_s)
        self.counts[why or "taken"] += 1
        if why:
            return
        if not points:
            self.hold()
            return
        order, start_s = [list(names).index(name) for name in self.joints], start_s or now_s
        q, qd = (self.desired, self.velocity) if self._begins_at_desired else measured
        began = (now_s, np.array(q), np.array(qd))
        coming = [
            (start_s + after_s, np.array(q)[order], np.array(qd)[order] if len(qd) and not self._is_linear else None)
            for after_s, q, qd in points
        ]
        self._points = [began, *(each for each in coming if each[0] > now_s)]

    def _refuse(self, names, points, start_s, now_s):
        if points and set(names) != set(self.joints):
            return "joints that are not its own" if set(names) - set(self.joints) else "some of its joints alone"
        times = [after_s for after_s, _, _ in points]
        if times != sorted(set(times)):
            return "times that do not increase"
        if any(len(q) != len(names) or len(qd) not in (0, len(names)) for _, q, qd in points):
            return "sizes"
        if points and start_s and start_s + times[-1] <= now_s:
            return "in the past"
        if points and not self._allows and np.abs(np.array(points[-1][2], dtype=float)).max(initial=0.0) > 1e-9:
            return "velocity at the end"
        return ""

    def update(self, now_s, measured):
        """Desired positions and velocities at a moment."""
        if self._points and np.abs(measured[0] - self.desired).max() > TOLERANCE_RAD:
            self.counts["tolerance"] += 1
            self.hold()
        if not self._points:
            return self.desired, self.velocity
        after = [index for index, each in enumerate(self._points) if each[0] > now_s]
        if after and not after[0]:  # time ran backwards
            self.hold()
            return self.desired, self.velocity
        if not after:
            self.desired = self._points[-1][1]
            self.hold()
            return self.desired, self.velocity
        (t0, q0, v0), (t1, q1, v1) = self._points[max(after[0] - 1, 0)], self._points[after[0]]
        span, s = t1 - t0, np.clip((now_s - t0) / (t1 - t0), 0.0, 1.0)
        if v0 is None or v1 is None:
            self.desired, self.velocity = q0 + s * (q1 - q0), (q1 - q0) / span
        else:
            c2, c3 = 3 * (q1 - q0) - (2 * v0 + v1) * span, 2 * (q0 - q1) + (v0 + v1) * span
            self.desired = q0 + v0 * span * s + c2 * s**2 + c3 * s**3
            self.velocity = v0 + (2 * c2 * s + 3 * c3 * s**2) / span
        return self.desired, self.velocity
