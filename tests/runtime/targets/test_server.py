"""The main loop of a world process: who is gone has no authority, and what was under way then does not happen."""

from multiprocessing import Pipe

import pytest

from phyagentos.runtime.channel import Link
from phyagentos.runtime.targets.handshake import Tokens
from phyagentos.runtime.targets.server import answer
from phyagentos.runtime.targets.wire import REQUESTS, Ack, Settle


class Recording:
    def __init__(self):
        self.handled = []

    def handle(self, request):
        self.handled.append(request)
        return Ack()

    def listen(self, client, tokens):
        pass

    def withdraw(self):
        pass

    def close(self):
        pass


@pytest.fixture
def ends():
    ours, theirs = Pipe()
    with ours:
        yield Link(ours), theirs


def test_a_request_whose_sender_goes_while_it_waits_for_its_period_does_not_happen(ends):
    ours, theirs = ends
    target = Recording()
    theirs.send_bytes(REQUESTS.encode(Settle(session="s", epoch=1, duration_s=0.02)))
    with pytest.raises(EOFError):
        answer(ours, target, Tokens(), lambda _request: theirs.close())
    assert target.handled == []
