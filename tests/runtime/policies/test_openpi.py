"""openpi's wire: what this project serves, what it asks, and what a hostile server can do to it: nothing."""

import contextlib
import pickle
import ssl
import threading
import urllib.request
from pathlib import Path

import msgspec
import numpy as np
import pytest
from websockets.sync.client import connect
from websockets.sync.server import serve as serve_websocket

from phyagentos.clock import SystemClock
from phyagentos.errors import DefectError, ExecutionError
from phyagentos.runtime.policies import openpi_client, openpi_codec, wire
from phyagentos.runtime.policies.client import PolicyClient, ask_policy
from phyagentos.runtime.policies.model_inputs import arrange
from phyagentos.runtime.policies.openpi_server import serve_openpi
from tests.certificates import make_certificate
from tests.policies import STREAM, describe, serve, take

CLOCK = SystemClock()
CAMERA = {"modality": "rgb", "shape": [4, 8, 3], "dtype": "uint8", "rate_hz": 25}
DESCRIPTOR = describe(
    "openpi://127.0.0.1:0",
    observations={
        "joint_state": STREAM | {"key": "observation/state"},
        "gripper_width": STREAM | {"shape": [], "unit": "m", "key": "observation/state"},
        "camera_rgb": CAMERA | {"key": "observation/image", "resize": [8, 8]},
    },
)
SHOWN = {
    "joint_state": np.array([0.1, 0.2]),
    "gripper_width": np.array(0.08),
    "camera_rgb": np.full((4, 8, 3), 7, dtype=np.uint8),
}
ROWS = np.arange(16.0).reshape(2, 8)


class Echo:
    """Remembers what it was asked; what `infer` does can be replaced."""

    def __init__(self):
        self.started, self.asked = [], []

    def start(self, request):
        self.started.append(request)

    def infer(self, request):
        self.asked.append(request)
        return ROWS, request.sequence == 1


@pytest.fixture
def served():
    return (policy := Echo()), serve(serve_openpi, policy, DESCRIPTOR)


def infer(sequence=0):
    return wire.Infer(session="s", sequence=sequence, rows_done=20 * sequence, time_s=1.5, observations=SHOWN)


@contextlib.contextmanager
def open_client(endpoint, timeout_s=5.0, **heartbeat):
    client = PolicyClient(endpoint, timeout_s, DESCRIPTOR.observations, **heartbeat)
    try:
        yield client
    finally:
        client.close()


def ask(client, sequence=0):
    client.ask(infer(sequence), None if sequence else wire.Start("s", "put it away", {"object": "cup"}, 7))
    return take(client)


def test_a_session_is_served_with_keys_pictures_and_words_as_its_model_takes_them(served):
    policy, endpoint = served
    with open_client(endpoint) as client:
        chunk = ask(client)
        assert chunk.rows == pytest.approx(ROWS)
        assert (chunk.done, ask(client, 1).done) == (False, True)
    (started,) = policy.started
    assert (started.session, started.instruction, started.seed) == ("s", "put it away", 7)
    assert started.parameters == {"object": "cup"}
    first, second = policy.asked
    assert first.observations["observation/state"] == pytest.approx([0.1, 0.2, 0.08])
    picture = first.observations["observation/image"]
    assert (picture.shape, picture.dtype) == ((8, 8, 3), np.uint8)
    assert picture[2:6].min() == 7
    assert picture[:2].max() == picture[6:].max() == 0, "its proportions stay"
    assert (second.sequence, second.rows_done, second.time_s) == (1, 20, 1.5)


def test_a_server_introduces_itself_and_is_healthy(served):
    _, endpoint = served
    assert ask_policy(endpoint) == DESCRIPTOR.model_copy(update={"endpoint": endpoint})
    with urllib.request.urlopen(endpoint.replace("openpi", "http") + "/healthz") as answer:
        assert (answer.status, answer.read()) == (200, b"OK\n")


def test_what_a_model_raises_comes_as_text_and_ends_in_words(served):
    policy, endpoint = served
    policy.infer = lambda _: 1 / 0
    with (
        open_client(endpoint) as client,
        pytest.raises(ExecutionError, match=r"(?s)POLICY_FAILED: .*ZeroDivisionError"),
    ):
        ask(client)
    with connect(endpoint.replace("openpi", "ws")) as other:
        other.recv()
        other.send("words")
        assert "a text frame" in other.recv()


def test_a_client_that_says_nothing_of_its_session_is_counted_by_its_requests(served):
    policy, endpoint = served
    with connect(endpoint.replace("openpi", "ws")) as other:
        assert openpi_codec.EXTENSION in openpi_codec.decode(other.recv())
        for _ in range(2):
            other.send(openpi_codec.encode({"state": np.zeros(2), "prompt": "go"}))
            answer = openpi_codec.decode(other.recv())
            assert answer["actions"] == pytest.approx(ROWS)
            assert answer["server_timing"]["infer_ms"] >= 0.0
    assert [(each.sequence, each.rows_done) for each in policy.asked] == [(0, 0), (1, 2)]
    assert [each.instruction for each in policy.started] == ["go"]


@pytest.fixture
def hostile():
    """A server whose connections are handled by a function of the test, after the metadata; its endpoint."""
    with contextlib.ExitStack() as stack:

        def start(handle, metadata=b"\x80", certificate=None):
            tls = None if certificate is None else ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            if tls is not None:
                tls.load_cert_chain(certificate)

            def receive(connection):
                if metadata is not None:
                    connection.send(metadata)
                with contextlib.suppress(Exception):
                    handle(connection)

            how = {"ssl": tls, "compression": None, "close_timeout": 0.1}
            server = stack.enter_context(serve_websocket(receive, "127.0.0.1", 0, **how))
            threading.Thread(target=server.serve_forever, daemon=True).start()
            return f"openpi{'' if tls is None else 's'}://127.0.0.1:{server.socket.getsockname()[1]}"

        yield start


def answer_with(*frames):
    def handle(connection):
        connection.recv()
        for frame in frames:
            connection.send(frame)
        connection.recv()

    return handle


def pack(**answer):
    return openpi_codec.encode(answer)


def lie(data=bytes(32), dtype="<f4", shape=(2, 4)):
    array = {b"__ndarray__": True, b"data": data, b"dtype": dtype, b"shape": shape}
    return msgspec.msgpack.encode({"actions": array})


def nest(depth):
    value = 1
    for _ in range(depth):
        value = {"a": value}
    return msgspec.msgpack.encode(value)


@pytest.mark.parametrize(
    ("frame", "told"),
    [
        ("Traceback: out of memory", "out of memory"),
        (b"", "no openpi message"),
        (b"\xc1", "no openpi message"),
        (b"\x92\x01\x02", "expected a map"),
        (pack(action=ROWS), "no array under 'actions'"),
        (pack(actions="up"), "no array under 'actions'"),
        (lie(shape=(4, 4)), r"shape \[4, 4\] and type float32, of 32 bytes"),
        (lie(shape=(2**40, 2**40)), "an array of the shape"),
        (lie(shape=(-2, -4)), "an array of the shape"),
        (lie(data="words"), "of str"),
        (lie(dtype="|O"), "expected booleans or numbers"),
        (lie(dtype="|O8"), "expected booleans or numbers"),
        (lie(dtype="<V4"), "expected booleans or numbers"),
        (nest(40), "deeper than"),
        (bytes(2**21), "more than 1048576 bytes"),
        (pack(actions=ROWS, phyagentos={"sequence": 5}), "chunk 5 came where 0 was requested"),
    ],
    ids=[*"abcdefghijklmnop"],
)
def test_an_answer_that_lies_is_a_fault_in_words(hostile, frame, told):
    with (
        open_client(hostile(answer_with(frame))) as client,
        pytest.raises(ExecutionError, match=f"POLICY_FAILED: .*{told}"),
    ):
        ask(client)


def test_a_server_with_tls_is_asked_where_its_certificate_is_trusted(hostile, tmp_path, monkeypatch):
    both, alone = make_certificate(tmp_path)
    endpoint = hostile(answer_with(pack(actions=ROWS)), certificate=both)
    assert endpoint.startswith("openpis://")
    with open_client(endpoint) as client, pytest.raises(ExecutionError, match="self-signed certificate") as error:
        ask(client)
    assert error.value.code == "POLICY_UNREACHABLE"
    monkeypatch.setenv("SSL_CERT_FILE", str(alone))
    with open_client(endpoint) as client:
        assert ask(client).rows == pytest.approx(ROWS)
    with pytest.raises(ExecutionError, match="Hostname mismatch"):
        ask_policy(endpoint.replace("127.0.0.1", "localhost"))
    with pytest.raises(ExecutionError) as error:
        ask_policy(endpoint.replace("openpis", "openpi"))
    assert error.value.code == "POLICY_UNREACHABLE"


class Spy:
    """Makes a file where it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def test_a_pickle_is_bytes_that_are_no_message(hostile, tmp_path):
    seen = tmp_path / "seen"
    data = pickle.dumps([Spy(seen)])
    array = {b"__ndarray__": True, b"data": data, b"dtype": "|O", b"shape": [1]}
    for frame in (data, msgspec.msgpack.encode({"actions": array}), msgspec.msgpack.encode({"actions": data})):
        with open_client(hostile(answer_with(frame))) as client, pytest.raises(ExecutionError, match="POLICY_FAILED"):
            ask(client)
    assert not seen.exists()
    pickle.loads(data)
    assert seen.exists(), "it would have been made"


@pytest.mark.parametrize(("of_answer", "of_array"), [(str, str), (str.encode, str.encode)], ids=["text", "bytes"])
def test_keys_of_text_and_of_bytes_are_the_same(hostile, of_answer, of_array):
    array = {"__ndarray__": True, "data": ROWS.tobytes(), "dtype": "<f8", "shape": ROWS.shape}
    message = {of_answer("actions"): {of_array(key): each for key, each in array.items()}}
    with open_client(hostile(answer_with(msgspec.msgpack.encode(message)))) as client:
        assert ask(client).rows == pytest.approx(ROWS)


def test_a_chunk_under_another_key_is_read_where_the_endpoint_names_it(hostile):
    endpoint = hostile(answer_with(pack(action=ROWS)))
    with (
        open_client(endpoint) as client,
        pytest.raises(ExecutionError, match=r"keys are action; name .* \?actions=KEY"),
    ):
        ask(client)
    with open_client(f"{endpoint}?actions=action") as client:
        assert ask(client).rows == pytest.approx(ROWS)


def test_what_a_model_misses_is_told_beside_what_it_was_shown_and_what_it_says_of_itself(hostile):
    endpoint = hostile(answer_with("KeyError: observation/wrist"), metadata=openpi_codec.encode({"action_horizon": 10}))
    with open_client(endpoint) as client, pytest.raises(DefectError, match="observation/wrist") as error:
        ask(client)
    assert "it was shown observation/state [3] float64, observation/image [8, 8, 3] uint8" in str(error.value)
    assert (client.metadata, error.value.place) == ({"action_horizon": 10}, endpoint)


def test_a_single_action_is_a_chunk_of_one_row(hostile):
    with open_client(hostile(answer_with(pack(actions=ROWS[0].astype(np.float32))))) as client:
        assert ask(client).rows == pytest.approx(ROWS[:1])


def test_an_answer_that_is_repeated_is_found_before_the_next_request(hostile):
    with open_client(hostile(answer_with(*[pack(actions=ROWS)] * 2))) as client:
        ask(client)
        CLOCK.sleep(0.1)
        with pytest.raises(ExecutionError, match="an answer to no request") as error:
            ask(client, 1)
    assert error.value.code == "POLICY_FAILED"


def test_a_server_that_drops_the_connection_is_lost(hostile):
    with (
        open_client(hostile(lambda connection: connection.recv())) as client,
        pytest.raises(ExecutionError, match="POLICY_LOST"),
    ):
        ask(client)


@pytest.mark.slow
def test_a_server_without_metadata_is_not_reached(hostile, monkeypatch):
    monkeypatch.setattr(openpi_client, "CONNECT_S", 0.5)
    with pytest.raises(ExecutionError, match=r"POLICY_UNREACHABLE: .*no metadata on connect"):
        ask_policy(hostile(lambda connection: connection.recv(), metadata=None))


def test_a_server_that_says_nothing_of_itself_is_not_compared(hostile):
    assert ask_policy(hostile(lambda connection: connection.recv())) is None


@pytest.mark.slow
def test_a_server_that_says_nothing_is_lost_when_the_time_of_the_contract_is_over(hostile):
    began_s = CLOCK.now_s()
    silent, told = hostile(lambda connection: CLOCK.sleep(1.0)), r"has sent nothing for 0\.2 s"
    with open_client(silent, timeout_s=0.2) as client, pytest.raises(ExecutionError, match=f"POLICY_LOST: .*{told}"):
        ask(client)
    assert CLOCK.now_s() - began_s < 3.0


def test_streams_of_one_key_and_turned_pictures_and_other_rotations():
    streams = {
        "camera_rgb": CAMERA | {"turned": True},
        "tool_pose": {
            "modality": "proprioception",
            "shape": [7],
            "rate_hz": 50,
            "rotation": "axis_angle",
            "key": "state",
        },
        "gripper_width": {"modality": "proprioception", "rate_hz": 50, "key": "state"},
    }
    declared = describe(observations=streams).observations
    picture = np.arange(96, dtype=np.uint8).reshape(4, 8, 3)
    turned = np.sqrt(0.5)
    shown = {"camera_rgb": picture, "tool_pose": np.array([1.0, 2.0, 3.0, turned, 0, 0, turned]), "gripper_width": 0.08}
    request = wire.Infer("s", 0, 0, 0.0, {name: np.asarray(value) for name, value in shown.items()})
    arranged = arrange(request, declared).observations
    assert np.array_equal(arranged["camera_rgb"], picture[::-1, ::-1])
    assert arranged["state"] == pytest.approx([1.0, 2.0, 3.0, 0.0, 0.0, np.pi / 2, 0.08])
