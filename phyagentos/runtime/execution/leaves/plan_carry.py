"""Ask for a way that keeps a held vessel level: straight tool lines, turning about the vertical only."""

from phyagentos.runtime.execution.codes import FailureCode
from phyagentos.runtime.execution.leaf import PortInformation, Status
from phyagentos.runtime.execution.planning import PlanningLeaf
from phyagentos.runtime.motion.poses import compute_matrix, compute_pose, raise_pose
from phyagentos.runtime.motion.requests import (
    Approach,
    Approaches,
    FindLine,
    MotionAnswer,
    MotionRequest,
    NoPlan,
    Payload,
)


class PlanCarry(PlanningLeaf):
    """A level way with the payload to the first of several approaches that can be reached so."""

    INPUT_PORTS = {
        "approaches": PortInformation(data_type=Approaches, description="Where it may end."),
        "payload": PortInformation(data_type=Payload, description="What is held, and how."),
        "over_m": PortInformation(data_type=float, default_value=0.09, description="Height above the end [m]."),
    }
    OUTPUT_PORTS = {"approach": PortInformation(data_type=Approach, description="The way, from here to the end.")}

    _tried = 0

    def compose(self) -> MotionRequest | Status:
        """Up, over, down."""
        approaches = self.read("approaches").approaches
        end = compute_matrix(approaches[self._tried].tcp_end)
        over = raise_pose(end, self.read("over_m"))
        here = compute_matrix(self.context.step.target.tcp)
        up = raise_pose(here, max(0.0, float(over[2, 3] - here[2, 3])))
        return FindLine(
            world=self.world(),
            q_rad=self.context.commands.q_rad,
            waypoints=tuple(compute_pose(pose) for pose in (up, over, end)),
            seed=self.context.draw_seed(self.path),
            payload=self.read("payload"),
            ignore=(),
        )

    def on_refused(self, answer: NoPlan) -> Status:
        """Try the next approach."""
        self._tried += 1
        if self._tried < len(self.read("approaches").approaches):
            return self.ask()
        self._tried = 0
        return super().on_refused(answer)

    def on_answer(self, answer: MotionAnswer) -> Status:
        """Write the way."""
        if not isinstance(answer, Approaches):
            return self.fail(FailureCode.PLANNER_LOST, f"asked for approaches, got {type(answer).__name__}")
        label = self.read("approaches").approaches[self._tried].label
        self._tried = 0
        self.write("approach", answer.approaches[0])
        return self.succeed("", label=label)
