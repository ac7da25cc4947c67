"""Several robots of one simulated world, each served to its own commander: under one lock, one time, one stop.

A thread serves each robot; it waits inside a command until the command's motion has ended. In real time one more
thread paces simulated time by the wall clock. An emergency stop brings every robot to rest.
"""

import threading
from collections.abc import Callable, Sequence

from typing_extensions import override

from phyagentos.clock import Clock
from phyagentos.runtime.channel import PeerChannel
from phyagentos.runtime.drivers.mujoco.simulation import ESTOPPED
from phyagentos.runtime.drivers.mujoco.world import MujocoDriver
from phyagentos.runtime.targets.handshake import Tokens
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget, beat
from phyagentos.runtime.targets.server import AHEAD_PERIODS, Pace
from phyagentos.runtime.targets.wire import Capture, InvokeTool, Reply, Request

LATE_SHARE = 0.25  # of a control period, by which a command may be late that was sent in time


class SharedTarget(ServedTarget):
    """One robot of a world that it shares with `members`, this target included.

    `keep_stop` makes the latch durable; it is called once every robot is at rest. `truth` permits the ground truth,
    `permits` a session's epoch by its token.
    """

    def __init__(
        self,
        driver: MujocoDriver,
        log: ReceiveLog,
        members: "list[SharedTarget]",
        *,
        is_estopped: Callable[[], bool] = lambda: False,
        keep_stop: Callable[[], None] = lambda: None,
        truth: bool = True,
        permits: Callable[[str, int, bytes], bool] = lambda _session, _epoch, _token: True,
    ) -> None:
        super().__init__(driver, log, is_estopped=is_estopped, keep_stop=keep_stop, truth=truth, permits=permits)
        self.robot, self._members = driver, members
        self._unnoted: list[str] | None = None  # events meanwhile, where a request is carried out
        members.append(self)

    @override
    def handle(self, request: Request) -> Reply:
        with self.robot.world.simulation.lock:
            if self._scene is not None and self._scene.episode != self.robot.world.episode:  # another robot began it
                self._scene = self._loaded = self._description = None
            if not isinstance(request, Capture | InvokeTool):
                self._unnoted = []
                reply, events, self._unnoted = super().handle(request), self._unnoted, None
                for kind in events:
                    self.note_event(kind)
                return reply
        return super().handle(request)  # pictures take longer than a period; the driver locks what it reads

    @override
    def note_event(self, kind: str) -> None:
        if self._unnoted is None:
            super().note_event(kind)
        else:  # what is carried out began before, and is noted with the time of its arrival
            self._unnoted.append(kind)

    @override
    def listen(self, client: PeerChannel, tokens: Tokens) -> None:
        self.robot.is_ending = lambda: self.look_for_stops() or tokens.is_stale or not beat(client)

    @override
    def withdraw(self) -> None:
        with self.robot.world.simulation.lock:
            super().withdraw()

    @override
    def look_for_stops(self) -> bool:
        with self.robot.world.simulation.lock:
            if not self._is_estopped():
                return False
            stopped = [each for each in self._members if each.revoke(ESTOPPED)]
            if stopped:
                self.robot.world.simulation.rest(ESTOPPED)
            for each in stopped:
                each.note_event("EStop")
        self._keep_stop()
        return True


def serve_together(
    targets: Sequence[SharedTarget], serve: Callable[[SharedTarget], None], pace_by: Clock | None = None
) -> None:
    """Serve the robots of one world, each on a thread of its own, until each is shut down.

    A world in real time is paced by the wall clock `pace_by`.
    """
    threads = [
        threading.Thread(target=serve, args=(target,), daemon=True, name=f"serve-{target.robot.profile.target}")
        for target in targets
    ]
    for thread in threads:
        thread.start()
    if pace_by is not None:
        keep_pace(targets, pace_by, lambda: not any(each.is_alive() for each in threads))
    for thread in threads:
        thread.join()


def keep_pace(targets: Sequence[SharedTarget], clock: Clock, should_end: Callable[[], bool]) -> None:
    """Pace the time of a shared world by the wall clock.

    Time runs ahead of the clock by two control periods at most, and only while every robot in motion has its next
    command. A robot whose command is a whole period late comes to rest; the others go on.
    """
    simulation = targets[0].robot.world.simulation
    simulation.is_paced = True
    pace, period_s, has_waited = Pace(simulation, clock), simulation.control_period_s, False
    while not should_end():
        with simulation.lock:
            targets[0].look_for_stops()
            lag_s = pace.compute_lag_s()
            is_ahead = lag_s <= -AHEAD_PERIODS * period_s
            if lag_s < period_s and (is_ahead or not simulation.is_eager()):
                simulation.lock.wait(min(period_s - lag_s, period_s))
                continue
            moving, commanded = {each for each in targets if each.is_moving}, simulation.find_commanded()
            late = [each for each in moving if each.robot.profile.target not in commanded]
            if late and not has_waited:  # this thread may have been late itself: a command may lie in a socket
                has_waited = True
                simulation.lock.wait(LATE_SHARE * period_s)
                continue
            for target in late:
                target.note_deadman()
            has_waited = False
            simulation.pass_period()
            if not moving and any(each.is_moving for each in targets):
                pace.begin_motion()
