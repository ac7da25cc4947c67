"""Writes the evidence bundle of one session: what was asked, observed, commanded and measured.

Upstream: the runner, which tells it what happens. Downstream: the verifier, which reads nothing else. During the loop
samples only go to memory; files are written before the first command and after the last one.
"""

import os
import platform
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import yaml

from phyagentos.protocol import evidence
from phyagentos.protocol.environment import Environment
from phyagentos.protocol.evidence import Event, TraceEvent, write_json, write_lines
from phyagentos.protocol.sessions import Execution, Session
from phyagentos.protocol.settings import compute_file_hash
from phyagentos.protocol.verdicts import Criterion
from phyagentos.runtime.actions.set_points import SetPoints
from phyagentos.runtime.targets.wire import FaultStruck, Observation, Step

RECORDED_PACKAGES = (
    "phyagentos", "numpy", "scipy", "mujoco", "mink", "daqp", "ompl", "toppra", "casadi", "numba", "py-trees",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Contract:
    """What was agreed before the first command.

    Attributes:
        plan: The adapter plan that preflight granted.
        settings: Settings files whose hashes go into the bundle.
    """

    session: Session
    epoch: int
    plan: Mapping[str, Any]
    settings: Sequence[Path]


class Recorder:
    """One bundle.

    Args:
        folder: `evidence/<session id>/`; made if it is missing.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._rows: list[tuple[float, ...]] = []
        folder.mkdir(parents=True, exist_ok=True)

    def write_contract(self, contract: Contract) -> None:
        """The resolved contract, the granted plan, the hashes of the settings, and the environment's fingerprint."""
        document = {
            "session": msgspec.to_builtins(contract.session),
            "epoch": contract.epoch,
            "adapter_plan": dict(contract.plan),
            "settings_sha256": {path.name: compute_file_hash(path) for path in contract.settings},
        }
        text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True)
        (self.folder / evidence.CONTRACT).write_text(text, encoding="utf-8")
        seeds = {"session": contract.session.seed, "scene": contract.session.scene.seed}
        write_json(self.folder / evidence.FINGERPRINT, {**read_fingerprint(), "seeds": seeds})

    def link_model(self, source: Path) -> bool:
        """Share the scene model of an earlier session of the same episode; False when it cannot be shared."""
        try:
            for name in (evidence.SCENE_MODEL, evidence.SCENE_XML):
                (self.folder / name).unlink(missing_ok=True)
                os.link(source / name, self.folder / name)
        except OSError:
            return False
        return True

    def write_initial(self, observation: Observation, environment: Environment) -> None:
        """The world before the first command."""
        self._write_state(evidence.INITIAL, observation)
        write_json(self.folder / evidence.BEFORE, environment)

    def write_terminal(self, observation: Observation, environment: Environment) -> None:
        """The world at rest after the last command."""
        self._write_state(evidence.TERMINAL, observation)
        write_json(self.folder / evidence.AFTER, environment)

    def write_picture(self, name: str, png: bytes) -> None:
        """A picture, unless the world could not make one."""
        if png:
            (self.folder / name).write_bytes(png)

    def on_turn(self, result: object, ticks: int, time_s: float) -> None:
        """Turns leave no sample; the tree keeps its own trace."""

    def on_step(self, points: SetPoints, step: Step) -> None:
        """Keep one sample: the end of a commanded period and what was measured there."""
        target = step.target
        self._rows.append(
            (
                step.time_s,
                *points.q_rad[-1].tolist(),
                *target.q_rad,
                *target.qd_rad_s,
                float(points.gripper_width_m[-1]),
                target.gripper_width_m,
            )
        )

    def write_course(
        self,
        *,
        trace: Sequence[TraceEvent],
        events: Sequence[Event],
        holds: Sequence[Criterion],
        faults: Sequence[FaultStruck],
        n_joints: int,
    ) -> None:
        """What happened between the first and the last command."""
        rows = np.array(self._rows, dtype=np.float64).reshape(len(self._rows), 3 * n_joints + 3)
        q_end, measured_end, velocity_end = 1 + n_joints, 1 + 2 * n_joints, 1 + 3 * n_joints
        np.savez(
            self.folder / evidence.TRAJECTORY,
            time_s=rows[:, 0],
            q_commanded=rows[:, 1:q_end],
            q_measured=rows[:, q_end:measured_end],
            qd_measured=rows[:, measured_end:velocity_end],
            gripper_commanded_m=rows[:, velocity_end],
            gripper_measured_m=rows[:, velocity_end + 1],
        )
        write_lines(self.folder / evidence.TRACE, list(trace))
        write_lines(self.folder / evidence.EVENTS, list(events))
        write_json(self.folder / evidence.HOLDS, list(holds))
        write_json(self.folder / evidence.FAULTS, list(faults))

    def write_execution(self, execution: Execution) -> None:
        """How it ended; the last file of a bundle."""
        write_json(self.folder / evidence.EXECUTION, execution)

    def _write_state(self, name: str, observation: Observation) -> None:
        np.savez(
            self.folder / name,
            state=observation.state,
            time=np.float64(observation.time_s),
            qpos=observation.qpos,
            qvel=observation.qvel,
            act=observation.act,
        )


@cache
def read_fingerprint() -> dict[str, Any]:
    """Versions of this process's packages, Python, operating system and CPU model."""
    versions = {}
    for package in RECORDED_PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "absent"
    return {
        "python": sys.version.split()[0],
        "system": f"{platform.system()} {platform.machine()}",
        "cpu": _read_cpu_model(),
        "packages": versions,
    }


def _read_cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or "unknown"
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")
