"""Call an action, a service or a topic of ROS 2, or a tool or other procedure of the target; follow it to its end.

The arm is held still meanwhile. What the procedure says of itself is its success; what is true the verdict says.
"""

from collections.abc import Mapping
from contextlib import suppress

import msgspec

from phyagentos.errors import ExecutionError, format_names
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.execution.call_check import KINDS, find_call, find_type
from phyagentos.runtime.execution.leaf import FailureCode, Leaf, LeafFailure, Port, PortInformation, Role, Status
from phyagentos.runtime.targets.wire import CallState, Progress

ACCEPT_S, CANCEL_S = 5.0, 2.0
_CARRIED: dict[str, object] = {  # type of a field -> of the port that takes it
    "number": float,
    "integer": int,
    "boolean": bool,
    "string": str,
    "pose": Pose,
    "point": tuple[float, float, float],
    "number[]": tuple[float, ...],
    "integer[]": tuple[int, ...],
    "boolean[]": tuple[bool, ...],
    "string[]": tuple[str, ...],
}


def _name(kind: str) -> PortInformation:
    return PortInformation(data_type=str, required=False, description=f"Name of the {kind}; one of {', '.join(KINDS)}.")


class Call(Leaf):
    """Call an action, service or topic of the robot, or another procedure of its target, and wait for its end."""

    ROLE = Role.ACT
    INPUT_PORTS = {
        **{kind: _name(kind) for kind in KINDS},
        "type": PortInformation(
            data_type=str, required=False, description="Of its messages, such as std_srvs/srv/Trigger."
        ),
        "goal": PortInformation(
            data_type=dict,
            required=False,
            description="Fields of the goal, request or message; a place or entity fills a pose or a point.",
        ),
        "accept_within_s": Port(
            data_type=float, minimum=0.0, default_value=ACCEPT_S, description="For its server to accept a goal [s]."
        ),
        "cancel_within_s": Port(
            data_type=float,
            minimum=0.0,
            maximum=5.0,
            default_value=CANCEL_S,
            description="For its server to confirm a cancel [s]; then the target takes no command any more.",
        ),
    }
    OUTPUT_PORTS = {
        "feedback": PortInformation(data_type=dict, required=False, description="Keys by field, written on the way."),
        "result": PortInformation(data_type=dict, required=False, description="Keys by field, written at the end."),
    }

    def on_start(self) -> Status:
        """Start it."""
        calls, self._late = self.context.calls, False
        name = find_call({kind: self.find(kind) for kind in KINDS})[1]
        live = calls.describe().procedures if calls is not None else ()
        procedure = next((each for each in live if each.name == name), None)
        if calls is None or procedure is None:
            known = format_names(each.name for each in live)
            return self.fail_for_good("REQUEST_INVALID", f"the target has no procedure {name!r}; there are {known}")
        self._calls, self._procedure, self._begun_s = calls, procedure, self.context.time_s
        goal = {path: self._fill(path, value) for path, value in self.read_fields("goal").items()}
        try:
            self._number, progress = calls.call(name, goal, self.read("cancel_within_s"))
        except ExecutionError as error:
            if error.code not in ("BUSY", "REQUEST_INVALID"):
                raise
            end = self.fail if error.code == "BUSY" else self.fail_for_good
            return end(error.code, f"{name}: {error.message}")
        return self._go_on(progress)

    def on_running(self) -> Status:
        """Follow it."""
        return self._go_on(self._calls.follow(self._number))

    def on_halted(self) -> None:
        """Cancel it, accepted or not; the target sees to its end."""
        with suppress(ExecutionError):  # a target that is lost or stopped has cancelled by itself
            self._calls.cancel(self._number)

    def _go_on(self, progress: Progress) -> Status:
        name, waited_s = self._procedure.name, self.context.time_s - self._begun_s
        self.write_fields("feedback", self._convert(progress.feedback, self._procedure.feedback))
        if not progress.state.has_ended:
            if progress.state is CallState.PENDING and waited_s > self.read("accept_within_s"):
                self._late = True
                self._calls.cancel(self._number)
            self.context.commands.hold()
            return Status.RUNNING
        says = f"{name} was {progress.state}" if progress.state is not CallState.SUCCEEDED else f"{name} says succeeded"
        numbers = {"procedure": name, "state": progress.state.value, "seconds": round(waited_s, 3)}
        says += f": {progress.message}" if progress.message else ""
        if self._late:
            late = f"{name} was not accepted within {self.read('accept_within_s'):g} s, and cancelled; {says}"
            return self.fail(FailureCode.TIMED_OUT, late, **numbers)
        if progress.state is not CallState.SUCCEEDED:
            return self.fail(FailureCode.CALL_FAILED, says, **numbers)
        self.write_fields("result", self._convert(progress.result, self._procedure.result))
        return self.succeed(says, **numbers)

    def _fill(self, path: str, value: object) -> object:
        """A value as the wire has it; the name of a place becomes a pose or a point where its field is one."""
        kind = find_type(self._procedure.goal, path)
        if isinstance(value, str) and kind in ("pose", "point"):
            now = self.belief
            place = now.regions.get(value) or now.entities.get(value)
            if place is None:
                raise LeafFailure(FailureCode.OBJECT_GONE, f"{value} is not in the world as observed", object=value)
            value = place.pose
        if isinstance(value, Pose):
            turned = {"position_m": value.position_m, "quaternion_wxyz": value.quaternion_wxyz}
            return value.position_m if kind == "point" else turned
        return value

    @staticmethod
    def _convert(values: Fields, types: Mapping[str, str]) -> Fields:
        """Values of the wire, as ports carry them; what has another form than described is left out."""
        found: Fields = {}
        for path, value in values.items():
            with suppress(KeyError, msgspec.ValidationError):
                found[path] = msgspec.convert(value, _CARRIED[types[path]])
        return found
