"""What is to be judged, and its judgement by `paos verify --bag` in the environment of phyagentos."""

import json
import os
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Verdict = Mapping[str, Any]  # `BagVerdict` as `paos verify --bag --json` prints it; of an unknown one at least `reason`
_OF_ROS = ("LD_LIBRARY_PATH", "PYTHONPATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")
_PATIENCE_S = 120.0


class Refused(Exception):
    """phyagentos refused the question, or could not be started; the text says why."""


@dataclass(frozen=True)
class Question:
    """Criteria over the objects of a scene; `settings` names topics, frames and clocks, as for a bag.

    Attributes:
        paos: The command of the environment that has phyagentos[export].
        robot: Of its library; by its joints where it is empty.
    """

    paos: str
    scene: str
    accept: tuple[str, ...]
    robot: str = ""
    settings: Path | None = None

    def check(self, empty: Path) -> None:
        """Raise Refused where no bag could answer; `empty` is a folder without a bag."""
        found = self._run(empty, empty / "verdict")
        if [(each["code"], each["address"]) for each in found.get("problems", ())] != [("UNREADABLE_FILE", str(empty))]:
            raise Refused(str(found.get("error", found)))

    def judge(self, bag: Path, evidence: Path) -> Verdict:
        """The verdict on a bag, its evidence in a new folder; raises Refused."""
        verdict = self._run(bag, evidence)
        if "verdict" not in verdict:
            raise Refused(str(verdict.get("error", verdict)))
        return verdict

    def _run(self, bag: Path, evidence: Path) -> Verdict:
        command = [self.paos, "verify", "--json", "--bag", str(bag), "--to", str(evidence), "--scene", self.scene]
        command += [part for each in self.accept for part in ("--accept", each)]
        command += ["--robot", self.robot] if self.robot else []
        command += ["--settings", str(self.settings)] if self.settings else []
        environment = {name: value for name, value in os.environ.items() if name not in _OF_ROS}
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, timeout=_PATIENCE_S, check=False
            )
            printed: Verdict = json.loads(done.stdout or done.stderr)
        except (OSError, ValueError, subprocess.TimeoutExpired) as error:
            raise Refused(f"{self.paos}: {error}") from error
        return printed
