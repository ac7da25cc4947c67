"""A slide that also rises by itself when it is called: procedures that misbehave as their goal says."""

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples" / "projects" / "05_any_body"))

from slide import Slide
from target_server.body import Entity
from target_server.procedures import Call, Procedure, Progress
from target_server.server import main
from target_server.wire import Refusal

HEIGHT = {"height_m": "number", "place": "pose", "ways[].speed": "number", "as": "string"}


class Rise(Call):
    """The load goes up with each step of the body; `as` says how it misbehaves."""

    def __init__(self, body, goal):
        self._body, self._goal_m, self._as = body, float(goal["height_m"]), goal.get("as", "")
        self.state, self.age = "pending" if self._as in ("silent", "slow") else "running", 0

    def step(self):
        self.age += 1
        if self.state == "pending" and self._as == "slow" and self.age > 5:
            self.state = "running"
        if self._as == "rejected" and self.age > 1:
            self.state = "rejected"
        if self.state not in ("running", "cancelling"):
            return
        if self.state == "cancelling" and self._as not in ("stubborn", "quick", "silent"):
            self.state = "cancelled"
        elif self._as == "lying" and self.age > 3:
            self.state = "succeeded"
        elif self._as not in ("lying", "silent"):
            self._body.load_m = min(self._body.load_m + 0.02, self._goal_m)
            self.state = "succeeded" if self._body.load_m == self._goal_m else self.state
        if self._as == "aborted" and self.age > 3:
            self.state = "aborted"
        if self._as == "lost" and self.age > 3:
            self.state = "lost"

    def read(self):
        height = {
            "height_m": self._body.load_m,
            "where": {"position_m": (0.0, 0.0, self._body.load_m), "quaternion_wxyz": (1.0, 0.0, 0.0, 0.0)},
        }
        ends = {"height_m": self._body.load_m, "steps": self.age} if self.state == "succeeded" else {}
        return Progress(self.state, height, ends, "by itself" if self.state == "aborted" else "")

    def cancel(self):
        if self.state in ("pending", "running"):
            self.state = "cancelled" if self.state == "pending" and self._as != "silent" else "cancelling"


class Lift(Slide):
    """Its load is `mark`, and set-points move only the slide beside it."""

    driver = "lift"
    procedures = (
        Procedure(
            "rise",
            goal=HEIGHT,
            feedback={"height_m": "number", "where": "pose"},
            result={"height_m": "number", "steps": "integer"},
        ),
        Procedure("hoist", goal={"height_m": "number"}),
        Procedure("ring", kind="service", type="std_srvs/srv/Trigger"),
    )

    def __init__(self):
        super().__init__()
        self.load_m, self._rises, self.emergencies = 0.0, [], 0

    def load(self, scene, seed, snapshot):
        super().load(scene, seed, snapshot)
        self.load_m = 0.0

    def list_entities(self):
        shape = {"kind": "sphere", "size_m": (0.01,), "pose": {}}
        return (Entity("mark", "mark", position_m=(0.0, 0.0, self.load_m), shapes=(shape,)),)

    def call(self, procedure, goal):
        strange = [path for path in goal if path not in HEIGHT]
        if procedure == "ring" or strange or not isinstance(goal.get("height_m"), float):
            raise Refusal("REQUEST_INVALID", f"{procedure} of {goal}")
        lies = {"as": "lying"} if procedure == "rise" and "RISE_LIES" in os.environ else {}
        self._rises.append(Rise(self, {**goal, **lies}))
        return self._rises[-1]

    def step(self, q, qd, width_m):
        self._rise()
        return super().step(q, qd, width_m)

    def stay(self):
        self._rise()
        super().stay()

    def _rise(self):
        for each in self._rises:
            each.step()


if __name__ == "__main__":
    main(Lift)
