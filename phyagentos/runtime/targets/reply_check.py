"""What a driver answers, checked once at the boundary of a target, before anything else reads it.

A reply that cannot be true is the target's fault, `PROTOCOL_BROKEN` with field and value: time that stands, jumps or
runs backwards, a number that is not finite, a list without end, text where a code or a file name belongs.
"""

import math
import re
from collections.abc import Iterator

import msgspec
import numpy as np

from phyagentos.codes import Phase, find_code
from phyagentos.errors import ExecutionError, format_names
from phyagentos.protocol.documents.plain_text import clean
from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.settings.runtime_contract import WorldMode
from phyagentos.protocol.world.environment import Pose
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.driver import TargetPort

HALT_MAX_S = 10.0  # of the target's time, to come to rest
STANDS = 1e-3  # of what was to pass, where time goes on by itself
LATE_MAX_S = 1.0  # of a command's end after its expiry and its period
ITEMS_MAX = 100_000  # numbers and texts of one reply, besides arrays
SMALL = 100  # of them in one list, or characters, of a report that needs no closer look
TEXT_MAX = 2**16  # characters of one text
SHOWN = 200  # of them in a message
UNIT_TOLERANCE = 0.01  # of the length of a quaternion
FILES = {
    wire.SCENE_MODEL: {evidence.SCENE_MODEL, evidence.SCENE_XML},
    wire.MOTION: {evidence.MOTION},
    wire.RENDER: {wire.PICTURE},
}
"""Files of the tools that a session uses."""
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")  # of a file of any other tool
_MAY_BE_INFINITE = re.compile(r"(gripper_force_n|q_(min|max)_rad\[\d+\])")  # of a description: unknown, without an end
_OF_STOPS = {Phase.SAFETY, Phase.TARGET}


class ReplyCheck:
    """Judges the replies of one driver in their order; knows the time of the latest one."""

    def __init__(self, driver: TargetPort) -> None:
        self._driver = driver
        self._live: wire.Description | None = None
        self._time_s = self._slack_s = math.nan

    def note_motion(self) -> None:
        """The driver has moved without a request, or by one whose reply has no time: its time may have gone on."""
        self._slack_s = HALT_MAX_S

    def forget_time(self) -> None:
        """The owner of an imagined world has put it to another moment."""
        self._time_s = math.nan

    def check(self, request: wire.RequestFor[wire.ReplyT], reply: wire.ReplyT) -> wire.ReplyT:
        """The reply; raises ExecutionError `PROTOCOL_BROKEN`."""
        fault = self._find_fault(request, reply)
        if fault:
            raise ExecutionError("PROTOCOL_BROKEN", f"{type(request).__name__} was answered with {fault}")
        match request, reply:
            case wire.LoadScene(), _:
                self._live, self._time_s = None, math.nan
            case wire.Begin() | wire.InvokeTool() | wire.Announce(), _:
                self.note_motion()
            case _, wire.Description():
                self._live = reply
        return reply

    def judge_refusal(self, error: ExecutionError) -> tuple[str, str]:
        """Code and message of a refusal by the driver; `PROTOCOL_BROKEN` where its code is none."""
        message = clean(error.message)[: 10 * SHOWN]
        if (row := find_code(error.code)) is not None:
            return row.name, message
        return "PROTOCOL_BROKEN", f"a refusal with the code {_show(error.code)}, which is none: {message}"

    def _find_fault(self, request: wire.Request, reply: wire.Reply) -> str:
        if isinstance(reply, wire.Step):  # every control period
            fault = "" if _is_plainly_sound(reply) else _find_unsound(reply)
            fault = fault or (_find_fault_of_code(reply.stopped, _OF_STOPS) if reply.stopped else "")
            fault = fault or self._find_fault_of_size(reply.target.q_rad, reply.target.qd_rad_s)
            return fault or self._find_fault_of_time(request, reply.time_s, is_stopped=bool(reply.stopped))
        fault = _find_unsound(reply)
        match reply:
            case wire.Observation(time_s, target):
                fault = fault or self._find_fault_of_size(target.q_rad, target.qd_rad_s)
                fault = fault or self._find_fault_of_time(request, time_s)
            case wire.Ended(time_s):
                fault = fault or self._find_fault_of_time(request, time_s)
            case wire.Description() if not (reply.physics_step_s > 0.0 < reply.steps_per_command):
                fault = fault or f"{reply.steps_per_command} steps of {reply.physics_step_s} s a command"
            case wire.ToolResult(artefacts) if isinstance(request, wire.InvokeTool):
                fault = fault or _find_foreign_file(request.name, artefacts)
            case wire.Frames(frames, missing):
                faults = [*(_find_fault_of_frame(each) for each in frames), *map(_find_fault_of_code, missing.values())]
                fault = fault or next(filter(None, faults), "")
        return fault

    def _find_fault_of_size(self, *joints: tuple[float, ...]) -> str:
        live = self._live
        wrong = [len(each) for each in joints if live is not None and len(each) != live.n_joints]
        return f"{wrong[0]} joints, where it described {live.n_joints}" if wrong and live is not None else ""

    def _find_fault_of_time(self, request: wire.Request, time_s: float, *, is_stopped: bool = False) -> str:
        """Where time moves by requests alone, each takes its own; elsewhere it goes on, and no command ends late."""
        before_s, slack_s, live = self._time_s, self._slack_s, self._live
        self._time_s, self._slack_s = time_s, 0.0
        if math.isnan(before_s) or live is None:
            return ""
        passed_s, step_s = time_s - before_s, live.physics_step_s
        found = f"the time {time_s:.3f} s after {before_s:.3f} s: "
        if passed_s < -0.5 * step_s:
            return f"{found}it runs backwards"
        least_s, most_s = _bound(request, step_s * live.steps_per_command, is_stopped=is_stopped)
        steps_alone = live.mode == WorldMode.LOCKSTEP and not live.shares_time
        expected_s = least_s - 0.5 * step_s if steps_alone else STANDS * least_s
        if passed_s < expected_s and (passed_s <= STANDS * least_s or not self._driver.is_ending()):  # asks the client
            return f"{found}it stands, where {least_s:g} s were to pass"
        if steps_alone and passed_s > most_s + slack_s + 0.5 * step_s:
            return f"{found}it jumps, where {most_s:g} s were to pass at most"
        if isinstance(request, wire.Command) and time_s > request.expires_at_s + most_s + LATE_MAX_S:
            return f"{found}the command had expired at {request.expires_at_s:.3f} s"
        return ""


def _bound(request: wire.Request, period_s: float, *, is_stopped: bool) -> tuple[float, float]:
    """How much time a request takes at least and at most [s]."""
    match request:
        case wire.Command():
            return (0.0, period_s + HALT_MAX_S) if is_stopped else (period_s, period_s)
        case wire.Settle(duration_s=duration_s):
            return duration_s, duration_s + HALT_MAX_S
        case wire.Halt() | wire.End():
            return 0.0, HALT_MAX_S
    return 0.0, 0.0


def _is_plainly_sound(value: object) -> bool:
    """Whether a small value has no fault; quicker than `_find_unsound`, which also finds the place of one."""
    match value:
        case float():
            return math.isfinite(value)
        case str() | tuple():
            return len(value) <= SMALL and (isinstance(value, str) or all(map(_is_plainly_sound, value)))
        case msgspec.Struct():
            is_turn = not (isinstance(value, Pose) and _is_no_turn(value))
            return is_turn and all(map(_is_plainly_sound, msgspec.structs.astuple(value)))
        case dict():
            return not value
    return value is None or isinstance(value, int)


def _find_unsound(reply: wire.Reply) -> str:
    """The first number that is not finite, quaternion that is no turn, or endless text; empty where all is sound."""
    is_description = isinstance(reply, wire.Description)
    for number, (where, leaf) in enumerate(_list_leaves(reply, "")):
        if number >= ITEMS_MAX:
            return f"more than {ITEMS_MAX} numbers and texts"
        if isinstance(leaf, float) and not math.isfinite(leaf):
            if not (is_description and _MAY_BE_INFINITE.fullmatch(where)):
                return f"{where} = {leaf}"
        elif isinstance(leaf, str) and len(leaf) > TEXT_MAX:
            return f"{where}, a text of {len(leaf)} characters, {TEXT_MAX} are possible"
        elif isinstance(leaf, Pose) and _is_no_turn(leaf):
            return f"{where}.quaternion_wxyz = {leaf.quaternion_wxyz}, which is no turn"
    return ""


def _list_leaves(value: object, where: str) -> Iterator[tuple[str, object]]:
    """Numbers, texts and poses below a value, with their paths."""
    if isinstance(value, msgspec.Struct):
        if isinstance(value, Pose):
            yield where, value
        for name in value.__struct_fields__:
            yield from _list_leaves(getattr(value, name), f"{where}.{name}".lstrip("."))
    elif isinstance(value, dict):
        for name, each in value.items():
            yield from _list_leaves(each, f"{where}[{_show(str(name))}]")
    elif isinstance(value, list | tuple):
        for index, each in enumerate(value):
            yield from _list_leaves(each, f"{where}[{index}]")
    elif not isinstance(value, np.ndarray):
        yield where, value
    elif value.dtype == np.float64:  # a depth may be NaN
        yield where, float(value.sum())


def _is_no_turn(pose: Pose) -> bool:
    return not abs(math.hypot(*pose.quaternion_wxyz) - 1.0) <= UNIT_TOLERANCE


def _find_fault_of_frame(frame: wire.Frame) -> str:
    expected = (frame.height, frame.width)
    if frame.rgb.shape == (*expected, 3) and frame.depth_m.shape == expected:
        return ""
    found = f"colours {frame.rgb.shape} and depths {frame.depth_m.shape}"
    return f"a frame of {_show(frame.camera)} with {found}, where its size is {expected}"


def _find_fault_of_code(code: str, phases: set[Phase] | None = None) -> str:
    row = find_code(code)
    return "" if row is not None and (phases is None or row.phase in phases) else f"{_show(code)} where a code belongs"


def _find_foreign_file(tool: str, names: dict[str, wire.Artefact]) -> str:
    known = FILES.get(tool)
    strange = [name for name in names if not (name in known if known else _NAME.fullmatch(name))]
    return f"a file {_show(strange[0])}; possible: {format_names(known or ['a plain name'])}" if strange else ""


def _show(text: str) -> str:
    return repr(clean(text)[:SHOWN])
