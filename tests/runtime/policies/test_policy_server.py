"""Conversations with a policy server over real sockets: what is asked, and what is wrong with an answer."""

import contextlib
import http.server
import socket
import threading

import numpy as np
import pytest

from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.client import PolicyClient, ask_policy
from phyagentos.runtime.policies.policy_server import answer, serve_policy
from tests.hostile_server import HostileServer
from tests.policies import describe, serve, take

CLOCK = SystemClock()
DESCRIPTOR = describe()


class Echo:
    """Answers with what it was shown, twice."""

    def __init__(self):
        self.started = []

    def start(self, request):
        self.started.append(request.session)

    def infer(self, request):
        shown = request.observations["joint_state"]
        if not np.isfinite(shown).all():
            raise ValueError("cannot see")
        return np.tile(shown, (2, 1)), request.rows_done > 0


@pytest.fixture(scope="module")
def endpoint():
    return serve(serve_policy, Echo(), DESCRIPTOR)


@pytest.fixture(scope="module")
def http_endpoint():
    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            request = wire.decode_request(self.rfile.read(int(self.headers["Content-Length"])))
            body = wire.encode(answer(request, Echo(), DESCRIPTOR))
            self.send_response(200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()
    server.server_close()


@pytest.fixture
def listener():
    """A server that accepts and says what the test lets it say."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


def infer(sequence=0, rows_done=0, shown=(0.1, 0.2)):
    observations = {"joint_state": np.asarray(shown)}
    return wire.Infer(session="s", sequence=sequence, rows_done=rows_done, time_s=0.0, observations=observations)


def serve_bytes(listener, *parts, pause_s=0.0):
    """Answer the first request with these bytes, one part after the other, and stay; the endpoint."""

    def speak():
        with contextlib.suppress(OSError), listener.accept()[0] as connection:
            connection.recv(65536)
            for part in parts:
                connection.sendall(part)
                CLOCK.sleep(pause_s)
            connection.recv(1)  # until the client hangs up

    threading.Thread(target=speak, daemon=True).start()
    return f"tcp://127.0.0.1:{listener.getsockname()[1]}"


def converse(endpoint, *requests, timeout_s=5.0):
    client = PolicyClient(endpoint, timeout_s)
    try:
        for index, each in enumerate(requests):
            client.ask(each, None if index else wire.Start("s", "do it", {}, 7))
            chunk = take(client)
        return chunk
    finally:
        client.close()


@pytest.fixture(params=["endpoint", "http_endpoint"])
def where(request):
    return request.getfixturevalue(request.param)


def test_a_server_describes_itself_and_answers_with_chunks(where):
    assert ask_policy(where) == DESCRIPTOR.model_copy(update={"endpoint": where})
    chunk = converse(where, infer(), infer(sequence=1, rows_done=2))
    assert (chunk.sequence, chunk.done) == (1, True)
    assert chunk.rows == pytest.approx(np.array([[0.1, 0.2], [0.1, 0.2]]))


def test_where_nobody_listens_the_server_is_unreachable():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(ExecutionError, match="POLICY_UNREACHABLE"):
        ask_policy(f"tcp://127.0.0.1:{port}")


def test_a_server_that_says_nothing_is_lost_and_nobody_waits_for_it(listener):
    client = PolicyClient(f"tcp://127.0.0.1:{listener.getsockname()[1]}", 0.05)
    client.ask(infer())
    assert client.poll() is None, "asking does not block"
    with pytest.raises(ExecutionError, match=r"POLICY_LOST: .*sent nothing for 0\.05 s"):
        take(client)
    client.close()


@pytest.mark.parametrize(
    "parts",
    [[b"\0\0"], [b"\0\0\1\0abc"], [b"\0\0\1\0", *([b"a"] * 256)]],
    ids=["half a length", "half a body", "a drip"],
)
def test_a_server_that_does_not_finish_its_answer_in_time_is_lost(listener, parts):
    began_s = CLOCK.now_s()
    with pytest.raises(ExecutionError, match=r"POLICY_LOST: .*only \d+ bytes of an answer within 0\.2 s"):
        converse(serve_bytes(listener, *parts, pause_s=0.05), infer(), timeout_s=0.2)
    assert CLOCK.now_s() - began_s < 2.0


def test_a_port_of_another_program_is_told_before_anything_is_asked(listener):
    endpoint = serve_bytes(listener, b"SSH-2.0-OpenSSH_9.2\r\n\r\n").replace("tcp", "openpi")
    with pytest.raises(ExecutionError, match="another program listens there: it speaks no WebSocket"):
        ask_policy(endpoint)


@pytest.mark.parametrize("length", [b"SSH-", b"\xff\xff\xff\xff"], ids=["another protocol", "negative"])
def test_an_answer_longer_than_any_chunk_is_a_fault_and_not_waited_for(listener, length):
    with pytest.raises(ExecutionError, match=r"POLICY_FAILED: .*an answer of \d+ bytes; at most 1048576"):
        converse(serve_bytes(listener, length), infer())


@pytest.mark.parametrize(
    ("length", "parts", "timeout_s", "code", "message"),
    [
        (256, [b"a"] * 256, 0.2, "POLICY_LOST", r"only \d+ bytes of an answer within 0\.2 s"),
        (2**25, [bytes(2**25)], 60.0, "POLICY_FAILED", "answered with more than 1048576 bytes"),
    ],
    ids=["a drip", "a flood"],
)
def test_over_http_an_answer_without_end_is_given_up_as_well(listener, length, parts, timeout_s, code, message):
    head = b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % length
    endpoint = serve_bytes(listener, head, *parts, pause_s=0.05).replace("tcp", "http")
    with pytest.raises(ExecutionError, match=f"{code}: .*{message}"):
        converse(endpoint, infer(), timeout_s=timeout_s)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("way", "code"),
    [("a drip of headers", "POLICY_LOST"), ("a gzip, gzip bomb", "POLICY_FAILED"), ("redirect", "POLICY_LOST")],
)
def test_a_server_over_http_cannot_hold_a_session(http_endpoint, way, code):
    server = HostileServer(way, http_endpoint)
    with pytest.raises(ExecutionError) as error:
        converse(server.url, infer(), timeout_s=0.2 if way == "a drip of headers" else 20.0)
    server.close()
    assert error.value.code == code


def test_the_words_of_a_fault_are_not_kept_without_end(listener):
    said = wire.encode(wire.Fault("x" * 10**6))
    with pytest.raises(ExecutionError, match="x") as error:
        converse(serve_bytes(listener, len(said).to_bytes(4, "big") + said), infer())
    assert len(str(error.value)) < 3000


@pytest.mark.parametrize("endpoint", ["http://a..b/", "http://[::1:5/", "tcp://[::1:5", "tcp://a..b:5", "tcp://a:x"])
def test_an_endpoint_that_is_none_is_told_and_not_raised(endpoint):
    with pytest.raises(ExecutionError) as error:
        ask_policy(endpoint)
    assert error.value.code in {"POLICY_UNREACHABLE", "POLICY_LOST"}


def test_a_server_that_hangs_up_is_lost(listener):
    def accept_and_go():
        listener.accept()[0].close()

    threading.Thread(target=accept_and_go, daemon=True).start()
    with pytest.raises(ExecutionError, match="POLICY_LOST"):
        converse(f"tcp://127.0.0.1:{listener.getsockname()[1]}", infer())


def test_what_comes_after_the_client_has_hung_up_is_not_listened_to(listener):
    asked, may_answer = threading.Event(), threading.Event()

    def speak():
        with listener.accept()[0] as connection:
            connection.recv(65536)
            asked.set()
            may_answer.wait(5)
            said = wire.encode(wire.Chunk(sequence=0, rows=np.zeros((1, 2))))
            connection.sendall(len(said).to_bytes(4, "big") + said)

    server = threading.Thread(target=speak, daemon=True)
    server.start()
    client = PolicyClient(f"tcp://127.0.0.1:{listener.getsockname()[1]}", 5.0)
    client.ask(infer())
    assert asked.wait(5)
    client.close()
    may_answer.set()
    server.join(5)
    client.wait(0.1)
    assert (client.poll(), client.is_waiting) == (None, False)


@pytest.mark.parametrize(
    "said",
    [b"", b"\xc1nonsense", wire.encode(wire.Started()), wire.encode(wire.Chunk(sequence=5, rows=np.zeros((1, 2))))],
    ids=["empty", "nonsense", "other", "late"],
)
def test_an_answer_that_is_none_is_a_fault(listener, said):
    client = PolicyClient(serve_bytes(listener, len(said).to_bytes(4, "big") + said), 5.0)
    client.ask(infer())
    with pytest.raises(ExecutionError, match="POLICY_FAILED"):
        take(client)
    client.close()


@pytest.mark.parametrize(
    ("said", "width"),
    [
        ((np.zeros((1, 8)), np.True_), 8),
        (([[0.0] * 8, [1] * 8], False), 8),
        ((np.zeros((1, 3), dtype=np.int64), 1), 3),
        (([[0.0], [0.0, 1.0]], False), None),
        ((np.array([["a"]]), False), None),
        (None, None),
    ],
    ids=["numpy bool", "lists", "whole numbers", "ragged", "words", "nothing"],
)
def test_whatever_a_model_returns_its_server_answers_and_goes_on(said, width):
    policy = Echo()
    policy.infer = lambda _: said
    where = serve(serve_policy, policy, DESCRIPTOR)
    for _ in range(2):
        if width is None:
            with pytest.raises(ExecutionError, match="POLICY_FAILED"):
                converse(where, infer())
        else:
            assert converse(where, infer()).rows.shape[1] == width
