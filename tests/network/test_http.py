"""Posts to servers that hold on to their clients: each ends within its limit, in time and in memory."""

import socket
import ssl
import threading
import tracemalloc

import pytest

from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.network.deadline import Deadline, connect
from phyagentos.network.http import HttpClient, _Backend, _Stream
from tests.hostile_server import WHEREVER, HostileServer

CODES = ("FAILED", "MALFORMED")
LATE = r"FAILED: .* has sent (only|nothing)"
END_OF = {
    "headers without end": "FAILED: .*RemoteProtocolError",
    "redirect": "FAILED: .* a redirect",
    "a body without end": "MALFORMED: .* more than",
    "a gzip bomb": "MALFORMED: .* encoding",
    "a gzip, gzip bomb": "MALFORMED: .* encoding",
}
MAX_BYTES = 2**20
PATIENCE_S = 20.0  # on a slow machine; a client without a limit would wait for ever


@pytest.fixture
def serve():
    servers = []

    def start(*arguments, **more):
        servers.append(HostileServer(*arguments, **more))
        return servers[-1]

    yield start
    for each in servers:
        each.close()


def post(url, body=b"x", timeout_s=0.3, max_bytes=MAX_BYTES, client=None):
    client = client or HttpClient(url, *CODES)
    try:
        return client.post(body, timeout_s=timeout_s, max_bytes=max_bytes)
    finally:
        client.close()


@pytest.mark.slow
@pytest.mark.parametrize("way", WHEREVER)
def test_whatever_a_server_does_the_exchange_ends_in_time_and_in_little_memory(serve, way):
    elsewhere = serve("silence")
    server = serve(way, elsewhere.url)
    body = bytes(2**24 if way == "a deaf server" else 1)  # more than the kernel takes for it
    timeout_s = PATIENCE_S if way in END_OF else 0.3
    tracemalloc.start()
    began_s = SystemClock().now_s()
    with pytest.raises(ExecutionError, match=END_OF.get(way, LATE)):
        post(server.url, body, timeout_s)
    took_s, (_, peak) = SystemClock().now_s() - began_s, tracemalloc.get_traced_memory()
    tracemalloc.stop()

    assert took_s < PATIENCE_S
    assert peak < 4 * MAX_BYTES
    assert elsewhere.requests == 0


@pytest.mark.slow
def test_a_server_that_says_nothing_of_tls_is_given_up(serve):
    with pytest.raises(ExecutionError, match=LATE):
        post(serve("silence").url.replace("http:", "https:"))


def test_a_connection_whose_time_is_over_before_tls_begins_is_closed():
    ours, theirs = socket.socketpair()
    with theirs, pytest.raises(TimeoutError):
        _Stream(ours, _Backend()).start_tls(ssl.create_default_context())
    assert ours.fileno() == -1


@pytest.mark.slow
def test_answers_come_over_one_connection_and_over_a_new_one_when_that_is_gone(serve):
    server = serve("a gzip bomb", polite=lambda request: None if request == b"bomb" else request * 2)
    client = HttpClient(server.url, *CODES)
    for body in (b"one", b"bomb", b"two"):
        if body == b"bomb":
            with pytest.raises(ExecutionError, match="in the encoding 'gzip'; none was requested"):
                client.post(body, timeout_s=PATIENCE_S, max_bytes=MAX_BYTES)
        else:
            assert client.post(body, timeout_s=PATIENCE_S, max_bytes=6) == body * 2
    with pytest.raises(ExecutionError, match="answered with more than 5 bytes"):
        client.post(b"two", timeout_s=PATIENCE_S, max_bytes=5)
    client.close()


@pytest.mark.parametrize("url", ["ftp://x/", "http:///x", "http://a..b/", "nothing", "http://127.0.0.1:9/"])
def test_where_nothing_can_be_asked_the_server_is_lost(url):
    with pytest.raises(ExecutionError, match=r"FAILED: .*(Error|UnsupportedProtocol)"):
        post(url, timeout_s=PATIENCE_S)


def test_a_name_that_is_not_found_in_time_holds_no_client(monkeypatch):
    release = threading.Event()
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: release.wait(60) and [])
    with pytest.raises(TimeoutError, match="no connection within"):
        connect("somewhere.example", 80, Deadline(0.1))
    with pytest.raises(ExecutionError, match=r"FAILED: http://somewhere\.example/ has sent nothing for 0\.1 s"):
        post("http://somewhere.example/", timeout_s=0.1)
    release.set()


def test_a_client_that_is_closed_meanwhile_ends(serve):
    client, ended = HttpClient(serve("silence").url, *CODES), threading.Event()

    def ask():
        with pytest.raises(ExecutionError, match=r"FAILED: .*Error"):
            client.post(b"x", timeout_s=60.0, max_bytes=1)
        ended.set()

    threading.Thread(target=ask, daemon=True).start()
    while not ended.wait(0.05):
        client.close()
