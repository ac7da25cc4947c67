"""10. A leader: another arm, read by its driver, moves one taken over. Run me: python examples/10_leader.py"""

import threading

import numpy as np

from phyagentos.drivers import TargetDriver
from phyagentos.policies import Array, Infer, PolicyDescriptor, Start, serve_policy

PERIOD_S, ROWS_MOST, REST_S = 0.02, 100, 0.1
SPEED, ACCELERATION = 0.5, 2.0  # of the joint that moves most [rad/s], [rad/s²]


class Leader:
    """The arm follows one of the same joints from where both are at first; each answer begins and ends at rest."""

    def __init__(self, leading: TargetDriver, opening_m: float) -> None:
        self._leading, self._opening_m = leading, opening_m
        self.is_back = threading.Event()

    def start(self, request: Start) -> None:
        self._at: Array | None = None

    def infer(self, request: Infer) -> tuple[Array, bool]:
        led = self._leading.observe(truth=False).target
        leading = np.array(led.q_rad)
        if self._at is None:
            self._at = np.array(request.observations["joint_state"][: leading.size])
            self._apart = self._at - leading
        way = leading + self._apart - self._at
        far = max(float(np.abs(way).max()), 1e-9)
        wanted_s = max(REST_S, 1.875 * far / SPEED, (5.774 * far / ACCELERATION) ** 0.5)  # of a quintic, at its fastest
        seconds = min(wanted_s, ROWS_MOST * PERIOD_S)
        share = np.linspace(0.0, 1.0, round(seconds / PERIOD_S) + 1)[1:]
        rows = self._at + np.outer(share**3 * (10.0 - 15.0 * share + 6.0 * share**2), way * (seconds / wanted_s) ** 2)
        self._at = rows[-1]
        opening = np.full(len(rows), min(led.gripper_width_m, self._opening_m))
        return np.column_stack((rows, opening)), self.is_back.is_set()


def lead(leading: TargetDriver, opening_m: float, endpoint: str = "tcp://127.0.0.1:5555") -> None:
    """Serve a leading arm for `paos take-over SESSION --speaks joints --leader ENDPOINT`, until enter is typed."""
    leader = Leader(leading, opening_m)
    descriptor = PolicyDescriptor(policy="leader/1", endpoint=endpoint, observations={}, inference_s=1.0)
    threading.Thread(target=serve_policy, args=(leader, descriptor), daemon=True).start()
    input("enter hands the arm back\n")
    leader.is_back.set()
    threading.Event().wait(3.0)  # the last answer is on its way


if __name__ == "__main__":
    import runpy
    from pathlib import Path

    from phyagentos.drivers import read_target

    folder = Path(__file__).parents[1]
    profile = read_target(folder / "benchmarks/library/robots/counter/target.yaml")
    slide = runpy.run_path(str(folder / "examples/09_driver.py"))["SlideDriver"](profile)
    leader = Leader(slide, opening_m=0.08)
    leader.start(Start(session="g.a", instruction="Lead.", parameters={}, seed=0))
    for slide._q[0] in (0.2, 0.3, 0.3):  # where the leading joint is pushed by hand
        seen = {"joint_state": np.array([0.5])}
        rows, _ = leader.infer(Infer(session="g.a", sequence=0, rows_done=0, time_s=0.0, observations=seen))
        print(f"led at {slide._q[0]:.1f}: {len(rows)} rows to {rows[-1][0]:.2f}")
