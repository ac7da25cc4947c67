"""Serves a policy of LeRobot's asynchronous inference over openpi's WebSocket protocol.

LeRobot's wire is gRPC with pickles: whoever answers may run code in the process that asked. This one asks, in LeRobot's
own environment (`pip install "lerobot[async]" websockets msgpack`); what it passes on is msgpack with plain arrays.

    python -m lerobot.async_inference.policy_server --host=127.0.0.1 --port=8080
    python lerobot_bridge.py act FOLDER --server 127.0.0.1:8080 --state 7 --camera front=96x96 --port 8000

`FOLDER` is where the policy server finds the policy; the bridge is ready once it has loaded it. A policy that fails is
a text frame; a server that has gone, or is silent, closes the connection with its name as the reason.
"""

import argparse
import contextlib
import itertools
import pickle
import sys
import threading
import time
from typing import Any

import grpc
import msgpack
import numpy as np
from lerobot.async_inference.helpers import RemotePolicyConfig, TimedAction, TimedObservation
from lerobot.transport import services_pb2, services_pb2_grpc
from lerobot.transport.utils import send_bytes_in_chunks
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

STATE, IMAGES, TASK, PROMPT = "observation.state", "observation.images.", "task", "prompt"
ROWS_MAX = 1000
MESSAGE_MAX_BYTES = 2**26  # some pictures
INTERNAL_ERROR = 1011  # of a WebSocket's end
REASON_MAX = 120  # bytes of the reason of a WebSocket's end
CLOSE_S, MEET_S = 0.5, 1.0
OPTIONS = [
    ("grpc.enable_retries", 0),  # a session has limits of its own
    ("grpc.max_receive_message_length", MESSAGE_MAX_BYTES),
    ("grpc.client_idle_timeout_ms", 2**31 - 1),  # an end of the connection is that of the server
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 500),  # a server that is back is met at once
]


class Lost(Exception):
    """The policy server has gone, or does not answer."""


class Refused(Exception):
    """An observation or an answer that is none."""


class PolicyServer:
    """LeRobot's policy server, asked for one chunk at a time.

    Args:
        address: `host:port`.
        setup: The policy that it is to load.
        timeout_s: Longest wait for a chunk [s].
        load_s: Longest wait until the policy is loaded [s].
    """

    def __init__(self, address: str, setup: RemotePolicyConfig, timeout_s: float, load_s: float) -> None:
        self._address, self._setup, self._timeout_s, self._load_s = address, setup, timeout_s, load_s
        self._channel = grpc.insecure_channel(address, OPTIONS)
        self._stub = services_pb2_grpc.AsyncInferenceStub(self._channel)
        self._asking, self._numbers = threading.Lock(), itertools.count()
        self._is_loaded = self._is_connected = False
        self.clients: set[ServerConnection] = set()
        self._channel.subscribe(self._watch)

    def meet(self) -> None:
        """See that the server is there; raises `Lost`."""
        try:
            grpc.channel_ready_future(self._channel).result(MEET_S)
        except grpc.FutureTimeoutError as error:
            raise Lost(
                f"LeRobot's policy server {self._address} is gone (no connection within {MEET_S:g} s)"
            ) from error

    def load(self) -> None:
        """Let the server load the policy, unless it has since it was connected to; raises `Lost` or `Refused`."""
        with self._asking:
            self._load()

    def infer(self, observation: dict[str, Any]) -> np.ndarray:
        """Rows (k, width) of the next chunk; raises `Lost` or `Refused`."""
        with self._asking:
            self._load()
            number = next(self._numbers)
            shown = TimedObservation(time.time(), number, observation, must_go=True)
            frames = send_bytes_in_chunks(pickle.dumps(shown), services_pb2.Observation)
            self._call(self._stub.SendObservations, frames, self._timeout_s)
            answer = self._call(self._stub.GetActions, services_pb2.Empty(), self._timeout_s).data
        actions: list[TimedAction] = pickle.loads(answer) if answer else []
        if not actions:
            raise Refused(f"{self._address} answered with no actions: its policy has failed, as its log explains")
        if actions[0].get_timestep() != number:
            raise Refused(f"{self._address} answered observation {actions[0].get_timestep()}, {number} was shown")
        return np.stack([each.get_action().double().numpy() for each in actions])

    def _load(self) -> None:
        if not self._is_loaded:
            setup = services_pb2.PolicySetup(data=pickle.dumps(self._setup))
            self._call(self._stub.Ready, services_pb2.Empty(), self._timeout_s)
            self._call(self._stub.SendPolicyInstructions, setup, self._load_s)
            self._is_loaded = True

    def _call(self, method: Any, request: Any, timeout_s: float) -> Any:
        try:
            return method(request, timeout=timeout_s)
        except grpc.RpcError as error:
            if error.code() is grpc.StatusCode.UNKNOWN:  # what its policy raised
                raise Refused(f"{self._address}: {error.details()}") from error
            self._is_loaded = False  # a new start also forgets what it was shown
            late = error.code() is grpc.StatusCode.DEADLINE_EXCEEDED
            silence = f"silent for {timeout_s:g} s" if late else f"gone ({error.code().name})"
            raise Lost(f"LeRobot's policy server {self._address} is {silence}") from error

    def _watch(self, state: grpc.ChannelConnectivity) -> None:
        """A server that is not connected any more has lost its policy, and every client is to know."""
        was_connected, self._is_connected = self._is_connected, state is grpc.ChannelConnectivity.READY
        if self._is_connected or not was_connected:
            return
        self._is_loaded = False
        for client in tuple(self.clients):
            client.close(INTERNAL_ERROR, f"LeRobot's policy server {self._address} is gone"[:REASON_MAX])


class Bridge:
    """Answers openpi's observations.

    Args:
        server: Is asked.
        forms: Shapes of the arrays that the policy takes, by their keys.
    """

    def __init__(self, server: PolicyServer, forms: dict[str, tuple[int, ...]]) -> None:
        self._server, self._forms = server, forms

    def receive(self, connection: ServerConnection) -> None:
        """One client, until it disconnects."""
        clients = self._server.clients
        clients.add(connection)
        try:
            self._server.meet()
            connection.send(msgpack.packb({"served_by": "lerobot"}))
            for frame in connection:
                rows = self._server.infer(self._read(frame))
                connection.send(msgpack.packb({"actions": pack(rows)}))
        except Lost as error:
            connection.close(INTERNAL_ERROR, str(error)[:REASON_MAX])
        except Refused as error:
            with contextlib.suppress(ConnectionClosed):
                connection.send(str(error))
            connection.close(INTERNAL_ERROR, "the policy has failed")
        except ConnectionClosed:
            pass
        finally:
            clients.discard(connection)

    def _read(self, frame: str | bytes) -> dict[str, Any]:
        """An observation as a robot of LeRobot gives it: a number for each motor, a picture for each camera."""
        try:
            given = msgpack.unpackb(frame, object_hook=unpack, strict_map_key=False)
            arrays = {key: given[key] for key in self._forms}
            found = {key: np.shape(value) for key, value in arrays.items()}
        except (TypeError, ValueError, KeyError, msgpack.UnpackException) as error:
            raise Refused(f"no observation of {', '.join(self._forms)}: {type(error).__name__} {error}") from error
        if found != self._forms:
            raise Refused(f"observations of the shapes {found}; the bridge was started for {self._forms}")
        shown: dict[str, Any] = {TASK: str(given.get(PROMPT, ""))}
        for key, value in arrays.items():
            if key == STATE:
                shown |= {f"{STATE}_{index}": float(each) for index, each in enumerate(value)}
            else:
                shown[key.removeprefix(IMAGES)] = np.asarray(value, dtype=np.uint8)
        return shown


def describe_features(forms: dict[str, tuple[int, ...]]) -> dict[str, dict[str, Any]]:
    """The features of a data set with these arrays, as LeRobot's policy server wants to know them."""
    return {
        key: {"dtype": "float32", "shape": shape, "names": [f"{STATE}_{index}" for index in range(shape[0])]}
        if key == STATE
        else {"dtype": "image", "shape": shape, "names": ["height", "width", "channels"]}
        for key, shape in forms.items()
    }


def pack(array: np.ndarray) -> dict[bytes, Any]:
    """An array as openpi writes it."""
    return {b"__ndarray__": True, b"data": array.tobytes(), b"dtype": array.dtype.str, b"shape": array.shape}


def unpack(value: dict[Any, Any]) -> Any:
    """The array of a map that openpi writes one as; every other map as it is."""
    if b"__ndarray__" not in value:
        return value
    dtype = np.dtype(value[b"dtype"])
    if dtype.kind not in "biuf":
        raise ValueError(f"an array of {dtype}")
    return np.frombuffer(value[b"data"], dtype=dtype).reshape(value[b"shape"])


def read_camera(text: str) -> tuple[str, tuple[int, ...]]:
    """`front=96x128`: name, height and width."""
    name, _, size = text.partition("=")
    height, width = size.split("x")
    return f"{IMAGES}{name}", (int(height), int(width), 3)


def main() -> None:
    """Serve until interrupted."""
    parser = argparse.ArgumentParser(description="Serves LeRobot's asynchronous inference as an openpi server.")
    parser.add_argument("kind", help="of the policy: act, smolvla, pi0, ...")
    parser.add_argument("policy", help="where the policy server finds it")
    parser.add_argument("--server", default="127.0.0.1:8080", help="host:port of LeRobot's policy server")
    parser.add_argument("--state", type=int, default=0, help=f"numbers under {STATE}")
    parser.add_argument("--camera", type=read_camera, action="append", default=[], help="name=HEIGHTxWIDTH")
    parser.add_argument("--rows", type=int, default=ROWS_MAX, help="most rows of a chunk; all without it")
    parser.add_argument("--device", default="cpu", help="of the policy")
    parser.add_argument("--timeout", type=float, default=10.0, help="longest wait for a chunk [s]")
    parser.add_argument("--load-timeout", type=float, default=600.0, help="longest wait for the policy to load [s]")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=8000)
    given = parser.parse_args()
    forms: dict[str, tuple[int, ...]] = dict(given.camera)
    if given.state:
        forms[STATE] = (given.state,)
    setup = RemotePolicyConfig(given.kind, given.policy, describe_features(forms), given.rows, given.device)
    server = PolicyServer(given.server, setup, given.timeout, given.load_timeout)
    try:
        server.load()
    except (Lost, Refused) as error:
        sys.exit(str(error))
    limits: dict[str, Any] = {"max_size": MESSAGE_MAX_BYTES, "close_timeout": CLOSE_S}
    with serve(Bridge(server, forms).receive, given.host, given.port, compression=None, **limits) as door:
        host, port = door.socket.getsockname()[:2]
        print(f"openpi://{host}:{port}", flush=True)
        door.serve_forever()


if __name__ == "__main__":
    main()
