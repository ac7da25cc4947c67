"""Processes that die: nothing is lost, nothing is repeated, every session reaches an end."""

import os
import signal
import threading

import pytest

from phyagentos.assembly.paths import make_socket_folder
from phyagentos.protocol.sessions.heartbeats import find_heartbeat
from tests.strangers import wait_in_the_backlog

pytestmark = [pytest.mark.journey, pytest.mark.usefixtures("starts_interpreters")]


def kill_worker_of(plane, goal: str, leaf: str) -> threading.Thread:
    """Kill -9 the worker as soon as its heartbeat shows that it executes this leaf in a session of the goal.

    The last beat of a worker that another journey has killed lies there until its successor's first.
    """

    def hunt() -> None:
        done = threading.Event()
        while not done.wait(0.01):
            beat = find_heartbeat(plane.workspace.heartbeats, "panda")
            if beat is None or not beat.session.startswith(f"{goal}."):
                continue
            if beat.phase == "executing" and beat.tick > 30 and leaf in beat.leaf:
                os.kill(beat.pid, signal.SIGKILL)
                return

    thread = threading.Thread(target=hunt, daemon=True)
    thread.start()
    return thread


def test_a_killed_worker_is_replaced_what_it_held_is_carried_on_and_who_waits_in_the_backlog_gets_nothing(rough_plane):
    """Its session is judged from the world, and what the hand holds is not dropped."""
    hunter = kill_worker_of(rough_plane, "killed-1", "place/carry")
    socket = make_socket_folder(rough_plane.workspace.root) / "panda.world"
    with wait_in_the_backlog(socket, "killed-1.red") as stranger:
        report = rough_plane.run("killed-1")
    hunter.join(1.0)

    assert not hunter.is_alive()
    assert report.sessions[0].ended == "runner_lost", report
    assert report.sessions[0].state == "replanned"
    rest = next(session for session in report.sessions if session.id.endswith(".r1"))
    assert (rest.skill, rest.state) == ("place", "succeeded"), report
    assert report.verdict == "success"
    assert (stranger.sent > 2, stranger.heard) == (True, [])
