"""What a client that has died left in the pipe, or waited with, is not carried out."""

import contextlib
import threading
from multiprocessing import Pipe

import numpy as np
import pytest

from phyagentos.assembly.worker_process import connect_to_world
from phyagentos.clock import SystemClock
from phyagentos.runtime.channel import Link
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.handshake import Tokens, make_key, mint
from phyagentos.runtime.targets.server import UnixDoor, answer, serve

PATIENCE_S = 10.0
KEY = make_key()


class BusyTarget:
    """Answers its first request when it is told to; remembers what it was asked."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.busy, self.may_go_on, self.withdrawn = threading.Event(), threading.Event(), threading.Event()

    def handle(self, request):
        self.asked.append(type(request).__name__)
        self.busy.set()
        self.may_go_on.wait(PATIENCE_S)
        return wire.Ack()

    def listen(self, client, tokens) -> None: ...

    def withdraw(self) -> None:
        self.withdrawn.set()

    def close(self) -> None: ...


@pytest.fixture
def target(tmp_path):
    target = BusyTarget()
    socket = str(tmp_path / "s")
    thread = threading.Thread(target=serve, args=(target, UnixDoor(socket), Tokens(KEY)), daemon=True)
    thread.start()
    yield target, socket
    with connect(socket) as last:
        last.send_bytes(wire.REQUESTS.encode(wire.Shutdown()))
        thread.join(PATIENCE_S)


def connect(socket: str):
    return contextlib.closing(connect_to_world(socket, mint(KEY), SystemClock()))


def make_command() -> wire.Command:
    q = np.zeros((1, 1))
    return wire.Command(
        session="s", epoch=1, sequence=1, expires_at_s=1.0, q_rad=q, qd_rad_s=q, gripper_width_m=np.zeros(1)
    )


@pytest.mark.parametrize("lives", [True, False])
def test_a_command_in_the_pipe_is_carried_out_only_while_its_sender_lives(target, lives):
    world, socket = target
    client = connect_to_world(socket, mint(KEY), SystemClock())
    client.send_bytes(wire.REQUESTS.encode(wire.Begin(session="s", epoch=1)))
    assert world.busy.wait(PATIENCE_S)
    client.send_bytes(wire.REQUESTS.encode(make_command()))
    if not lives:
        client.close()
    world.may_go_on.set()
    if lives:
        for _ in range(2):
            wire.receive_reply(client, PATIENCE_S)
        client.close()
    assert world.withdrawn.wait(PATIENCE_S)

    assert world.asked == (["Begin", "Command"] if lives else ["Begin"])


def test_a_request_whose_sender_goes_while_it_waits_for_its_period_does_not_happen():
    target, (ours, theirs) = BusyTarget(), Pipe()
    theirs.send_bytes(wire.REQUESTS.encode(wire.Settle(session="s", epoch=1, duration_s=0.02)))
    with ours, pytest.raises(EOFError):
        answer(Link(ours), target, Tokens(), lambda _request: theirs.close())
    assert target.asked == []
