"""Policy servers that misbehave, each behind a skill of its own; everything else is as in its example.

Those that fail begin with a chunk that stands still, so that preflight and the first half second pass.
"""

import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np

from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.runtime.policies.policy_server import serve_policy
from phyagentos.runtime.policies.wire import Infer, Start

SKILL = Path(__file__).parents[2] / "examples" / "projects" / "03_policy_server" / "skills" / "imitate" / "SKILL.md"
CHUNK = 25  # rows, as in SKILL.md
SWING_RAD, SWING_ROWS = 0.15, 75  # 1.5 s there and back: well below the limits of the joint
WIDEST_M = 0.078  # a hair less than the gripper opens, so that no spline between two chunks passes its limit
HANGS_S = 3.0  # longer than a session of these cases waits for its policy
READY_S = 10.0

Answer = Callable[[np.ndarray, int], tuple[np.ndarray, bool]]


def _hang(still: np.ndarray, done: int) -> tuple[np.ndarray, bool]:
    """Fall silent."""
    if done:
        threading.Event().wait(HANGS_S)
    return still, False


def _garble(still: np.ndarray, done: int) -> tuple[np.ndarray, bool]:
    """Leave a column out."""
    return (still[:, :-1] if done else still), False


def _break(still: np.ndarray, done: int) -> tuple[np.ndarray, bool]:
    """Say what is no number."""
    return (np.full_like(still, np.nan) if done else still), False


def _idle(still: np.ndarray, done: int) -> tuple[np.ndarray, bool]:
    """Say that it is done, without a command."""
    return still[:0], True


def _pretend(still: np.ndarray, done: int) -> tuple[np.ndarray, bool]:
    """Swing the first joint from home to one side and back, touch nothing, and say that it is done."""
    rows, phase = still.copy(), np.minimum((done + np.arange(len(still))) / SWING_ROWS, 1.0)
    rows[:, 0] = SWING_RAD * np.sin(np.pi * phase) ** 2
    return rows, done + len(still) >= SWING_ROWS


MANNERS: dict[str, Answer] = {
    "policy_hangs": _hang,
    "policy_garbles": _garble,
    "policy_breaks": _break,
    "policy_idles": _idle,
    "policy_pretends": _pretend,
}


class Misbehaving:
    """A policy of one manner.

    Args:
        answer: From rows that stand still and the number of rows that were carried out to a chunk.
    """

    def __init__(self, answer: Answer) -> None:
        self._answer = answer

    def start(self, request: Start) -> None:
        """Every session is treated alike."""

    def infer(self, request: Infer) -> tuple[np.ndarray, bool]:
        """The next chunk."""
        shown = request.observations
        posture = np.append(shown["joint_state"], np.minimum(shown["gripper_width"], WIDEST_M))
        return self._answer(np.tile(posture, (CHUNK, 1)), request.rows_done)


def serve_policies(project: Path, names: list[str]) -> None:
    """Serve policies until this process ends, and write a skill for each below `project/skills`."""
    skill, _ = read_skill(SKILL)
    assert skill.policy is not None
    for name in names:
        ready, found = threading.Event(), list[str]()

        def tell(endpoint: str, ready: threading.Event = ready, found: list[str] = found) -> None:
            found.append(endpoint)
            ready.set()

        descriptor = PolicyDescriptor.model_validate(skill.policy.model_dump() | {"endpoint": "tcp://127.0.0.1:0"})
        served = (Misbehaving(MANNERS[name]), descriptor, tell)
        threading.Thread(target=serve_policy, args=served, daemon=True).start()
        if not ready.wait(READY_S):
            raise RuntimeError(f"the policy {name} is not served")
        folder = project / "skills" / name
        folder.mkdir(parents=True)
        text = SKILL.read_text(encoding="utf-8").replace(skill.policy.endpoint, found[0])
        (folder / "SKILL.md").write_text(text.replace("skill: imitate", f"skill: {name}"), encoding="utf-8")
