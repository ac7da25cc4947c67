"""`paos take-over`: the arm of a running session is moved from the keyboard, or by a leader of the person's own."""

import getpass
import select
import sys
import termios
import threading
import tty
from collections.abc import Callable
from functools import partial
from queue import Queue
from typing import Annotated, Literal

import numpy as np
import typer

from phyagentos.cli.outcome import Exit, ExitCode, print_note
from phyagentos.cli.reply import Reply
from phyagentos.cli.stopping import Space, show
from phyagentos.clock import SystemClock
from phyagentos.operations import stop
from phyagentos.operations.stop import Stopped
from phyagentos.policies import Array, Infer, PolicyDescriptor, Start, serve_policy

STEP_M, STEP_RAD, ROW_S = 0.01, 0.05, 0.1
SHIFTS = {
    "w": (STEP_M, 0, 0, 0, 0, 0), "s": (-STEP_M, 0, 0, 0, 0, 0), "a": (0, STEP_M, 0, 0, 0, 0),
    "d": (0, -STEP_M, 0, 0, 0, 0), "r": (0, 0, STEP_M, 0, 0, 0), "f": (0, 0, -STEP_M, 0, 0, 0),
    "q": (0, 0, 0, 0, 0, STEP_RAD), "e": (0, 0, 0, 0, 0, -STEP_RAD),
}  # fmt: skip
STEP = np.array((STEP_M,) * 3 + (STEP_RAD,) * 3)
MOST, REST_ROWS = 12, 6  # steps of one way at most; rows more than steps, so that it begins and ends gently
GRIPPER, BACK = " ", "\n"
KEYS = "w s: away, back · a d: left, right · r f: up, down · q e: turn · space: gripper · enter: hand back"
FOLLOWED_S, SENT_S = 3.0, 0.5  # without a request the session has ended; the last answer is on its way
TAKEN_S = 15.0  # until the runtime follows: a motion that plans is interrupted first


class Keyboard:
    """The keys of a person as a policy of steps of the tool; each way that is typed begins and ends at rest.

    `width_max_m` is how far the gripper opens [m].
    """

    def __init__(self, width_max_m: float) -> None:
        self._width_max_m, self._width_m = width_max_m, -1.0
        self._left = np.zeros(6)  # of the way that was typed
        self._changed = threading.Condition()
        self._is_over = False
        self._clock, self._asked_at_s = SystemClock(), np.inf
        self.is_taken, self.is_back = threading.Event(), threading.Event()

    def press(self, key: str) -> None:
        """One key; those without a meaning are ignored."""
        with self._changed:
            self._left += SHIFTS.get(key, 0.0)
            self._is_over = self._is_over or key == BACK
            if key == GRIPPER:
                self._width_m = 0.0 if self._width_m > self._width_max_m / 2 else self._width_max_m
            self._changed.notify()

    @property
    def is_followed(self) -> bool:
        """Whether the session still asks for rows."""
        return self._clock.now_s() < self._asked_at_s + FOLLOWED_S

    @property
    def is_moving(self) -> bool:
        """Whether a way that was typed is not gone yet."""
        return bool(self._left.any())

    def start(self, request: Start) -> None:
        """The arm is the person's now."""
        self.is_taken.set()

    def infer(self, request: Infer) -> tuple[Array, bool]:
        """(k, 7) rows of the way that was typed: x, y, z [m], rotation vector [rad], in the world, and opening [m].

        One row at rest where none was; the opening stays as it is at first.
        """
        self._asked_at_s = self._clock.now_s()
        with self._changed:
            if not self._left.any():
                self._changed.wait_for(lambda: self._is_over or self._left.any(), ROW_S)
            if self._width_m < 0.0:
                self._width_m = float(request.observations["gripper_width"])
            way = np.clip(self._left, -MOST * STEP, MOST * STEP)
            self._left -= way
            if self._is_over:
                self.is_back.set()
            steps = int(np.abs(way / STEP).max().round())
            share = np.linspace(0.0, 1.0, steps + REST_ROWS if steps else 2)
            rows = np.outer(np.diff(share**3 * (10.0 - 15.0 * share + 6.0 * share**2)), way)
            return np.column_stack((rows, np.full(len(rows), self._width_m))), self._is_over


def take_over(
    session: Annotated[str, typer.Argument(metavar="SESSION")],
    workspace: Space = None,
    by: Annotated[str, typer.Option(help="Who; it is recorded.")] = "",
    leader: Annotated[str, typer.Option(help="A policy server of yours here, instead of the keyboard.")] = "",
    speaks: Annotated[Literal["tool", "joints"], typer.Option(help="What its rows are.")] = "tool",
) -> Reply[Stopped]:
    """Move the arm of a running session yourself, guarded as ever; once you hand it back, the session is judged."""
    request = partial(stop.take_over, session, workspace, by=by or getpass.getuser())
    if leader:
        return show(request(leader=leader, speaks=speaks))
    if not sys.stdin.isatty():
        what = "paos take-over: its keys need a terminal; without one name a server: --leader tcp://127.0.0.1:PORT"
        raise Exit(ExitCode.INVALID_INPUT, what)
    return Reply(_lead(Keyboard(stop.find_opening(session, workspace)), request))


def _lead(keyboard: Keyboard, request: Callable[..., Stopped]) -> Stopped:
    """Serve the keys until the arm is handed back; Ctrl-C hands it back, too."""
    addresses = Queue[str]()
    descriptor = PolicyDescriptor(policy="keyboard", endpoint="tcp://127.0.0.1:0", observations={}, inference_s=1.0)
    threading.Thread(target=serve_policy, args=(keyboard, descriptor, addresses.put), daemon=True).start()
    found = request(leader=addresses.get())
    if not keyboard.is_taken.wait(TAKEN_S):
        what = f"paos take-over: nothing follows within {TAKEN_S:g} s: does the session run? See `paos status`."
        raise Exit(ExitCode.GOAL_NOT_MET, what)
    print_note(f"the arm is yours. {KEYS}")
    before = termios.tcgetattr(sys.stdin)
    try:
        tty.setcbreak(sys.stdin)
        while not keyboard.is_back.is_set() and keyboard.is_followed:
            keyboard.press(sys.stdin.read(1) if select.select([sys.stdin], [], [], ROW_S)[0] else "")
    except KeyboardInterrupt:
        keyboard.press(BACK)
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)
    ended = "handed back" if keyboard.is_back.wait(FOLLOWED_S) else "the session has ended"
    SystemClock().sleep(SENT_S)
    print_note(f"{ended}; what came of it: `paos why`")
    return found
