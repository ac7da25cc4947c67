"""The base of every leaf: typed ports, a sealed `update`, and failures that carry a code.

Authors declare `INPUT_PORTS` and `OUTPUT_PORTS` and write `on_start`, `on_running` and, where something must be undone,
`on_halted`. A leaf never blocks: it returns RUNNING and is ticked again after the next control period. Port values
stay with the tree, not on the blackboard of the process.
"""

import copy
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from enum import StrEnum
from typing import Any, ClassVar, final

from py_trees.behaviour import Behaviour
from py_trees.common import Status
from py_trees.ports import NoDataAvailable, PortInformation
from py_trees.ports_utils import is_instance_of_type

from phyagentos.errors import PhyAgentOSError, find_place, list_foreign_errors
from phyagentos.geometry import Vector
from phyagentos.overtime import limit_time
from phyagentos.protocol.documents.plain_data import Fields, to_plain
from phyagentos.protocol.sessions.session import Limits
from phyagentos.protocol.sessions.trace import Role
from phyagentos.protocol.world.environment import Entity, Environment
from phyagentos.runtime.execution.context import SkillContext
from phyagentos.runtime.execution.first_motions import Foreseen, foresee_by_role
from phyagentos.runtime.execution.ports import Port, find_misfit
from phyagentos.runtime.perception.world_model import BELIEF, Need

TICK_S = 0.7 * Limits().heartbeat_s  # for a person's leaf, by the wall clock: its worker is given up after all of it
__all__ = ["FailureCode", "Leaf", "LeafError", "LeafFailure", "Port", "PortInformation", "Role", "Status"]


class FailureCode(StrEnum):
    """Why a leaf that ships failed: what was found, not what to do; plug-ins may add codes."""

    OBJECT_GONE = "OBJECT_GONE"
    """The object is not in the believed world."""
    OBJECT_HIDDEN = "OBJECT_HIDDEN"
    """The object is believed, but was not seen."""
    GRASP_MISSED = "GRASP_MISSED"
    """The fingers closed and do not hold the object."""
    GRASP_LOST = "GRASP_LOST"
    """The object was held and is not any more."""
    STILL_HELD = "STILL_HELD"
    """The fingers opened and still hold the object."""
    STALLED = "STALLED"
    """A motor does not follow its set-points, or the tree runs and neither commands nor plans."""
    TIMED_OUT = "TIMED_OUT"
    """A timeout of the tree ran out, in simulated time."""
    CALL_FAILED = "CALL_FAILED"
    """A procedure of the target was rejected, aborted or cancelled, or its server is gone."""
    CONTACT = "CONTACT"
    """A guarded motion met something."""
    UNMET = "UNMET"
    """A condition of the tree is false or unknown, or a child of a cooldown ended too short a time ago."""
    RUNNER_LOST = "RUNNER_LOST"
    """The planner process died or broke its protocol."""
    MOTION_CONFLICT = "MOTION_CONFLICT"
    """Another robot stood in the way for too long."""
    NOT_AT_START = "NOT_AT_START"
    """A motion does not begin where the arm stands."""


class LeafError(PhyAgentOSError):
    """A leaf raised: a defect of its code, or a service it needs is gone; `place` is `file:line` in that code."""

    def __init__(self, path: str, cause: BaseException, place: str) -> None:
        self.path = path
        self.cause = cause
        self.place = place
        super().__init__(f"leaf {path}: {type(cause).__name__}: {cause} ({place})")


class LeafFailure(Exception):
    """Raised in a leaf instead of returning `fail`: FAILURE with a coded reason, from any depth of its code."""

    def __init__(self, code: str, message: str, **numbers: Any) -> None:
        self.code, self.message, self.numbers = code, message, numbers
        super().__init__(message)


class Leaf(Behaviour):
    """One action or question of a skill; `ROLE` stands in every trace event, unstated it moves nothing (`SENSE`).

    Attributes:
        path: Slash-separated names from the root of the tree.
        code: Coded reason of the latest failure, else empty; `message` is one sentence about the latest result.
        is_final: Whether that failure is not worth another attempt.
        numbers: Measurements and decisions.
        activations: Number of starts.
    """

    ROLE: ClassVar[Role] = Role.SENSE
    INPUT_PORTS: Mapping[str, PortInformation] = {}
    OUTPUT_PORTS: Mapping[str, PortInformation] = {}

    def __init_subclass__(cls, **kwargs: Any) -> None:
        """Refuse a port that is an input and an output."""
        super().__init_subclass__(**kwargs)
        for port in cls.INPUT_PORTS.keys() & cls.OUTPUT_PORTS.keys():
            raise ValueError(f"port {port!r} of {cls.__name__} is an input and an output")

    def __init__(self, name: str, context: SkillContext, path: str = "") -> None:
        super().__init__(name)
        self.context = context
        self.path = path or name
        self.code = ""
        self.message = ""
        self.is_final = False
        self.numbers: Fields = {}
        self.activations = 0
        self._active = False
        self._values: Fields = {}
        self._keys: Mapping[str, str] = {}

    def wire(self, values: Fields, keys: Mapping[str, str]) -> None:
        """Connect ports to the tree's values by `keys`, from port to key; defaults of outputs are written at once.

        An unconnected input has no value; values written to an unconnected output are dropped.
        """
        self._values, self._keys = values, keys
        for port, declared in self.OUTPUT_PORTS.items():
            if declared.has_default:
                self.write(port, copy.deepcopy(declared.default_value))

    @property
    def belief(self) -> Environment:
        """The world as it is believed now: what is held has moved with the hand, nothing is looked at anew."""
        return self.context.world.observe(BELIEF)

    def get_entity(self, name: str, need: Need = BELIEF) -> Entity:
        """An entity of the world as believed, or as a look shows it; the leaf fails with `OBJECT_GONE` without it."""
        if (entity := self.context.world.observe(need).entities.get(name)) is None:
            raise LeafFailure(FailureCode.OBJECT_GONE, f"{name} is not in the world as observed", object=name)
        return entity

    @classmethod
    def foresee(cls, wired: Mapping[str, Any], path: str) -> Foreseen:
        """What it surely does first with these inputs, for a dry run; override it where its role does not say it.

        Inputs that only the running tree knows are None or absent; `path` is its own.
        """
        return foresee_by_role(cls.ROLE, wired, path)

    def on_start(self) -> Status:
        """First tick of an activation."""
        raise NotImplementedError(f"{type(self).__name__} must define on_start")

    def on_running(self) -> Status:
        """Every later tick of an activation."""
        raise NotImplementedError(f"{type(self).__name__} answered RUNNING and must define on_running")

    def on_halted(self) -> None:
        """The activation was interrupted; set-points brake by themselves."""

    @final
    def initialise(self) -> None:
        """Begin an activation."""
        self.code, self.message, self.is_final, self.numbers = "", "", False, {}
        self.activations += 1
        self._active = False

    @final
    def update(self) -> Status:
        """Dispatch one tick; sealed."""
        begin = self.on_running if self._active else self.on_start
        try:
            with self._limit():
                status = begin()
        except LeafFailure as failure:
            status = self.fail(failure.code, failure.message, **failure.numbers)
        except list_foreign_errors() as error:
            self._active = False
            raise LeafError(self.path, error, find_place(error, type(self))) from error
        try:
            self._check_answer(begin.__name__, status)
        except list_foreign_errors() as error:
            raise LeafError(self.path, error, find_place(error, begin)) from error
        self._active = status is Status.RUNNING
        return status

    def _limit(self) -> AbstractContextManager[None]:
        """Of a tick of a person's leaf: shorter than the silence for which its worker would be given up."""
        if type(self).__module__.startswith("phyagentos."):
            return nullcontext()
        return limit_time(TICK_S)

    def _check_answer(self, name: str, status: object) -> None:
        """Raise TypeError for what is no answer; numbers become plain data, as evidence holds them."""
        if not isinstance(status, Status) or status is Status.INVALID:
            raise TypeError(f"{name} answered {status!r:.80}; expected SUCCESS, FAILURE or RUNNING")
        self.message = str(self.message)
        if self.numbers:
            self.numbers = to_plain(self.numbers)

    @final
    def terminate(self, new_status: Status) -> None:
        """Call `on_halted` after an interruption; sealed."""
        if new_status is Status.INVALID and self._active:
            self._active = False
            try:
                with self._limit():
                    self.on_halted()
            except list_foreign_errors() as error:
                raise LeafError(self.path, error, find_place(error, type(self))) from error

    def succeed(self, message: str = "", **numbers: Any) -> Status:
        """SUCCESS, with measurements and decisions."""
        self.message = message
        self.numbers = numbers
        return Status.SUCCESS

    def fail(self, code: str, message: str, **numbers: Any) -> Status:
        """FAILURE, with its coded reason."""
        self.code, self.message = str(code), message
        self.numbers = numbers
        return Status.FAILURE

    def fail_for_good(self, code: str, message: str, **numbers: Any) -> Status:
        """FAILURE that another attempt with this skill would meet again: the node goes on by other means, or ends."""
        self.is_final = True
        return self.fail(code, message, **numbers)

    def read(self, port: str) -> Any:
        """The value of a required input, or its declared default."""
        declared = self.INPUT_PORTS[port]
        key = self._keys.get(port)
        if key is None or key not in self._values:
            if declared.has_default:
                return copy.deepcopy(declared.default_value)
            raise NoDataAvailable(f"nothing was written to input {port!r} of {self.path}")
        return _check(port, self._values[key], declared)

    def find(self, port: str) -> Any:
        """The value of an optional input, or None when nothing was written to it."""
        try:
            return self.read(port)
        except NoDataAvailable:
            return None

    def find_point(self, port: str) -> Vector | None:
        """The point [m] of an optional input, or None when nothing was written to it."""
        point = self.find(port)
        return None if point is None else (float(point[0]), float(point[1]), float(point[2]))

    def read_fields(self, port: str) -> Fields:
        """What was given to an input that is a mapping, by the paths of its fields."""
        given = {path.removeprefix(f"{port}."): key for path, key in self._keys.items() if path.startswith(f"{port}.")}
        return {path: self._values[key] for path, key in given.items() if key in self._values}

    def write_fields(self, port: str, values: Fields) -> None:
        """Write those fields of an output that is a mapping which have a key."""
        self._values.update(
            {self._keys[path]: values[each] for each in values if (path := f"{port}.{each}") in self._keys}
        )

    def write(self, port: str, value: Any) -> None:
        """Write an output; whole numbers pass as numbers."""
        declared = self.OUTPUT_PORTS[port]
        if declared.data_type is float and isinstance(value, int):
            value = float(value)
        _check(port, value, declared)
        if port in self._keys:
            self._values[self._keys[port]] = value


def _check(port: str, value: Any, declared: PortInformation) -> Any:
    if value is None or not is_instance_of_type(value, declared.data_type):
        raise TypeError(f"port {port!r} carries {declared.data_type}, not {value!r}")
    if declared.data_type is float and (expected := find_misfit(value, declared)):
        raise ValueError(f"port {port!r} carries {expected}, not {value!r}")
    return value
