"""6. A policy: observations in, rows of set-points out, for any server or wire. Run me: python examples/06_policy.py"""

import numpy as np

from phyagentos.policies import Array, Infer, Start, serve_policy

ROWS, RATE_HZ = 25, 50.0


class Wave:
    """Swings the first joint by 0.1 rad, once in two seconds, and is done after four."""

    def start(self, request: Start) -> None:
        print(f"{request.session}: {request.instruction}", flush=True)

    def infer(self, request: Infer) -> tuple[Array, bool]:
        begin = request.rows_done
        rows = np.tile(request.observations["joint_state"][:7], (ROWS, 1))
        rows[:, 0] = 0.1 * np.sin(np.pi * np.arange(begin, begin + ROWS) / RATE_HZ)
        return rows, begin + ROWS >= 4 * RATE_HZ


if __name__ == "__main__":
    import sys

    from phyagentos.policies import PolicyDescriptor, answer

    if "--serve" in sys.argv:  # a skill names the endpoint in the block `policy` of its SKILL.md
        joints = {"modality": "joint_state", "shape": (7,), "rate_hz": RATE_HZ}
        facts = {"policy": "wave/1", "endpoint": "tcp://127.0.0.1:5555", "inference_s": 0.1}
        serve_policy(Wave(), PolicyDescriptor.model_validate({**facts, "observations": {"joint_state": joints}}))
    wave = Wave()
    answer(Start(session="g.a", instruction="Wave.", parameters={}, seed=0), wave)
    seen = {"joint_state": np.zeros(7)}
    for done in (0, 175):
        chunk = answer(Infer(session="g.a", sequence=done, rows_done=done, time_s=0.0, observations=seen), wave)
        print(f"after {done} rows: {chunk.rows.shape} more, done: {chunk.done}")
