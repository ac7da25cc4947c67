"""The time of one simulated world and its robots: who moves, when a physics step is due, when time stands.

A world of one robot moves by that robot's commands alone, at once. With several, in lockstep, a physics step is taken
when every robot that runs a session has a motion to carry out; the others hold. Time also stands until the runtime
plane and this world agree on the running sessions, so that planning, verdicts and starts take no simulated time.
Robots act in the order of their names: a run repeats bit for bit.
"""

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import mujoco

from phyagentos.runtime.drivers.mujoco.inter_robot_collisions import InterRobotCollisions
from phyagentos.runtime.drivers.mujoco.joint_controller import JointController, Motion
from phyagentos.runtime.models.world import CompiledScene

ReadAgreement = Callable[[], Mapping[str, str] | None]
"""Session that runs on each target, by the target's name, as the runtime plane has it; None while that may change."""

POLL_S = 0.1  # between two reads of the runtime plane's state, without an event
PATIENCE = 10  # such looks, until a motion of a session that the runtime plane has given up is given up too
RUNNER_LOST, ESTOPPED, ABORTED = "RUNNER_LOST", "ESTOPPED", "ABORTED"
BROKEN_OFF = frozenset({RUNNER_LOST, ESTOPPED, ABORTED})  # motions that were given up from outside, while they waited


class Body(Protocol):
    """A robot of the world, as its driver presents it."""

    @property
    def session(self) -> str:
        """The running session; empty without one."""

    @property
    def controller(self) -> JointController:
        """Of the present episode."""

    @property
    def is_ending(self) -> Callable[[], bool]:
        """Called by a motion that waits: whether its session is to end."""


@dataclass(slots=True)
class _Move:
    """A motion that a driver waits for; `ended` is the code of the stop that broke it off, empty for none."""

    motion: Motion
    ended: str | None = None


@dataclass(slots=True, eq=False)
class Simulation:
    """Bodies under one time.

    Attributes:
        read_agreement: Read before time moves, where several robots share it; None without a runtime plane.
        bodies: By name; they join before the first scene is loaded.
        is_paced: Whether `pass_period` alone moves time, by the wall clock.
        lock: Guards a shared world.
        ending: Robots whose session is to end; they come to rest while the others stand.
    """

    read_agreement: ReadAgreement | None = None
    bodies: dict[str, Body] = field(default_factory=dict)
    scene: CompiledScene | None = None
    control_period_s: float = math.nan
    is_paced: bool = False
    lock: threading.Condition = field(default_factory=threading.Condition)
    ending: set[str] = field(default_factory=set)
    collisions: InterRobotCollisions | None = None
    _moves: dict[str, _Move] = field(default_factory=dict)
    _standing: dict[str, Motion] = field(default_factory=dict)
    _primed: set[str] = field(default_factory=set)

    @property
    def time_s(self) -> float:
        """Simulated time [s]; NaN while no scene is loaded."""
        return float(self.scene.data.time) if self.scene is not None else math.nan

    def join(self, name: str, body: Body) -> None:
        """Add a robot."""
        self.bodies = dict(sorted({**self.bodies, name: body}.items()))

    def begin_episode(self, scene: CompiledScene, collisions: InterRobotCollisions | None = None) -> None:
        """Another scene is the present; no robot moves."""
        self.scene, self.collisions = scene, collisions
        self._moves.clear()
        self._standing.clear()
        self._primed.clear()

    def carry_out(self, name: str, motion: Motion, *, may_abort: bool = False) -> str:
        """A motion of a robot, from its beginning to its end, or until its session is to end while it waits.

        Returns:
            Code of the stop that broke it off, empty when it was carried out.
        """
        if len(self.bodies) == 1:
            scene = self._get_scene()
            try:
                while True:
                    next(motion)
                    mujoco.mj_step(scene.model, scene.data)
            except StopIteration as end:
                return str(end.value or "")
        move = self._moves[name] = _Move(motion)
        self._standing.pop(name, None)
        self._primed.discard(name)
        self.lock.notify_all()
        patience = PATIENCE
        while move.ended is None:
            agreed = self._read_agreed()
            if not self.is_paced and self._may_move(agreed):
                while not self._prime():
                    self._step()
                self.lock.notify_all()
            elif not self.lock.wait(POLL_S):
                if self.bodies[name].is_ending():
                    self.ending.add(name)
                if agreed is not None:
                    patience = PATIENCE if agreed.get(name, "") == self.bodies[name].session else patience - 1
                if name in self.find_commanded() and (not patience or (may_abort and name in self.ending)):
                    self._primed.discard(name)
                    move.ended = ABORTED if patience else RUNNER_LOST
        if self._moves.get(name) is move:
            del self._moves[name]
        return move.ended

    def let_stand(self, name: str) -> None:
        """End a robot's session: it comes to rest as time passes, at once where no other session runs."""
        with self.lock:
            self._moves.pop(name, None)
            self._primed.discard(name)
            self.ending.discard(name)
            if not any(body.session for body in self.bodies.values()):
                self.rest("")
            self.lock.notify_all()

    def rest(self, code: str) -> None:
        """Bring every robot to rest now; pending motions end under `code`."""
        if self.scene is None:
            return
        with self.lock:
            waited = {name: move for name, move in self._moves.items() if move.ended is None}
            self._moves = {
                name: _Move(body.controller.halt())
                for name, body in self.bodies.items()
                if name in waited or body.controller.is_moving
            }
            if self._moves:
                self._primed.clear()
                self._standing.clear()
                self._prime_all()
            while any(move.ended is None for move in self._moves.values()):
                self._step()
                self._prime_all()
            for move in waited.values():
                move.ended = code
            if code:
                self.ending.update(name for name, body in self.bodies.items() if body.session)
            self._moves.clear()
            self.lock.notify_all()

    def is_eager(self) -> bool:
        """Whether there is a motion to carry out, and every moving robot has its next command."""
        waited = self.find_commanded()
        return bool(waited) and all(
            name in waited or not body.controller.is_moving for name, body in self.bodies.items()
        )

    def find_commanded(self) -> set[str]:
        """Robots with a motion to carry out."""
        return {name for name, move in self._moves.items() if move.ended is None}

    def pass_period(self) -> None:
        """Let a control period pass; robots without a motion come to rest and hold."""
        for _ in range(round(self.control_period_s / self._get_scene().model.opt.timestep)):
            self._prime_all()
            self._step()
        self._prime(also_standing=False)  # a command is over with its last step
        self.lock.notify_all()

    def _read_agreed(self) -> Mapping[str, str] | None:
        if self.read_agreement is None:
            return {name: body.session for name, body in self.bodies.items()}
        return self.read_agreement()

    def _may_move(self, agreed: Mapping[str, str] | None) -> bool:
        """Whether every running robot has a motion, and the runtime plane agrees on the running sessions."""
        commanded = self.find_commanded()
        if not self.ending.isdisjoint(commanded):
            bodies = self.bodies.items()
            return all(name in commanded or not (body.session and body.controller.is_moving) for name, body in bodies)
        running = {name: body.session for name, body in self.bodies.items() if body.session}
        if agreed is None or not running or not commanded.issuperset(running):
            return False
        return {name: session for name, session in agreed.items() if session} == running

    def _prime_all(self) -> None:
        """Let each robot prepare the coming physics step; one whose motion has ended holds."""
        while self._prime():
            pass

    def _prime(self, *, also_standing: bool = True) -> bool:
        """Let each robot prepare the coming physics step, once; whether a motion ended instead."""
        has_ended = False
        for name, body in self.bodies.items():
            if name in self._primed:
                continue
            move = self._moves.get(name)
            if move is None or move.ended is not None:
                if not also_standing:
                    continue
                if name not in self._standing:
                    self._standing[name] = body.controller.stand()
                next(self._standing[name])
            else:
                try:
                    next(move.motion)
                except StopIteration as end:
                    move.ended, has_ended = str(end.value or ""), True
                    continue
            self._primed.add(name)
        return has_ended

    def _step(self) -> None:
        scene = self._get_scene()
        mujoco.mj_step(scene.model, scene.data)
        if self.collisions is not None:
            self.collisions.note()
        self._primed.clear()

    def _get_scene(self) -> CompiledScene:
        if self.scene is None:
            raise RuntimeError("a motion without a scene")  # drivers refuse requests before a scene is loaded
        return self.scene
