"""9. A driver: moves one body, here a slide in memory. Run me: python examples/09_driver.py"""

import numpy as np

from phyagentos import drivers as d

AXIS = d.Kinematics(axes=((0.0, 0.0, 1.0),), anchors_m=((0.0, 0.0, 0.0),), tcp_m=(0.0, 0.0, 0.0), slides=(True,))


class SlideDriver(d.TargetDriver):
    """One joint, which stands at once where the last set-point puts it."""

    def __init__(self, profile: d.TargetProfile) -> None:
        self.profile, self._time_s, self._q = profile, float("nan"), np.zeros(1)

    time_s = property(lambda self: self._time_s)
    is_moving = property(lambda self: False)

    def describe(self) -> d.Description:
        return self.describe_profile(driver="slide", q_min_rad=(-1.0,), q_max_rad=(1.0,), kinematics=AXIS)

    def load(self, request: d.LoadScene) -> d.Loaded:
        self._time_s, self._q = 0.0, np.zeros(1)
        return d.Loaded(request.episode, "")

    def apply(self, command: d.Command) -> str:
        self.check_set_points(command)
        self._q = command.q_rad[-1].copy()
        self._time_s += self.profile.control_period_s
        return ""

    def hold(self, duration_s: float) -> None:
        self._time_s += duration_s

    def halt(self, category: int = 2) -> None:
        """It always rests."""

    def report(self) -> d.Step:
        return d.Step(time_s=self.time_s, target=self._read(), tracking_error_rad=0.0)

    def observe(self, *, truth: bool) -> d.Observation:
        return d.Observation(time_s=self.time_s, target=self._read())

    def snapshot(self) -> None:
        """It has none."""

    def _read(self) -> d.TargetState:
        q = float(self._q[0])
        return d.TargetState(q_rad=(q,), qd_rad_s=(0.0,), gripper_width_m=0.0, tcp=d.Pose((0.0, 0.0, q)))


SLIDE = d.DriverSpec(open=lambda site: SlideDriver(site.profile), kinds=("simulation",))

if __name__ == "__main__":
    from pathlib import Path

    from phyagentos.testing import DRIVER_CHECKS, DriverSubject

    profile = d.read_target(Path(__file__).parents[1] / "benchmarks/library/robots/counter/target.yaml")
    for check in DRIVER_CHECKS:
        check(DriverSubject(open=lambda: SlideDriver(profile), scene="any"))
        print(f"{check.__name__}: satisfied")
