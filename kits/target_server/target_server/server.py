"""Serves a body at a WebSocket of this machine: one client at a time, admitted by a token.

    from target_server.server import main
    main(MyBody)        # python my_body.py --port 7000 < KEY

Without TLS it listens on this machine alone. The key, in hexadecimal digits, is the first line of standard input; the
server ends when standard input does. A client that disconnects or answers no ping
loses its authority: the body halts.
"""

import argparse
import hmac
import ipaddress
import ssl
import sys
import threading
import time
from collections.abc import Callable, Sequence

from target_server import wire
from target_server.body import Body
from target_server.served import ReceiveLog, Served
from target_server.websocket import LOOK_S, Connection, Door
from target_server.wire import KEY_BYTES, MESSAGE_MAX_BYTES, VERSION, Refusal

GREETING_S = 2.0
IDLE_S = 0.1  # without a client, between looks at whether this is the end


def serve_body(
    body: Body,
    key: bytes,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    certificate: str | None = None,
    log: str | None = None,
    stop_file: str | None = None,
    on_open: Callable[[str], None] = print,
    ended: threading.Event | None = None,
) -> None:
    """Serve until a `Shutdown`, or until `ended` is set; `on_open` gets the endpoint.

    `certificate` is a PEM file of a certificate chain and its private key: TLS, which any host but this machine needs.
    The receive log is appended to `log`. While `stop_file` exists the emergency stop is set.

    Raises:
        ValueError: The key has another length, or the host would be reached without TLS.
    """
    if len(key) != KEY_BYTES:
        raise ValueError(f"a key of {len(key)} bytes; {KEY_BYTES} are needed")
    if certificate is None and not (host == "localhost" or ipaddress.ip_address(host).is_loopback):
        raise ValueError(f"host {host} without a certificate; only this machine (127.0.0.1) is reached without TLS")
    tls = None
    if certificate is not None:
        tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        tls.load_cert_chain(certificate)
    door = Door(host, port, tls)
    on_open(f"{'wss' if tls else 'ws'}://{host}:{door.port}")
    served = Served(body, key, ReceiveLog(log), stop_file)
    ended = ended or threading.Event()
    try:
        while not ended.is_set():
            if (client := door.wait(IDLE_S)) is not None:
                _serve_client(served, client, key, ended)
    finally:
        door.close()
        body.close()


def _serve_client(served: Served, client: Connection, key: bytes, ended: threading.Event) -> None:
    """Until this client is gone."""
    try:
        if not client.poll(GREETING_S):
            return
        _admit(client, key)
        answered_s = time.monotonic()
        while not ended.is_set():
            if not client.poll(served.period_s if served.awaits_command else LOOK_S):
                served.watch(time.monotonic() - answered_s)
                continue
            message = client.receive()
            if not client.is_open:  # what a client that is gone has left in the pipe must not happen
                raise EOFError
            try:
                request = wire.decode(message)
                reply = served.handle(request, client)
            except Refusal as refusal:
                request, reply = {}, {"type": "Refused", "code": refusal.code, "message": str(refusal)}
            client.send(wire.encode(reply.pop("type"), **reply))
            answered_s = time.monotonic()
            if request.get("type") == "Shutdown":
                ended.set()
    except (EOFError, ConnectionRefusedError):
        pass
    finally:
        served.withdraw()
        client.close()


def _admit(client: Connection, key: bytes) -> None:
    """Answer the greeting; raises ConnectionRefusedError."""
    try:
        version, token = wire.decode_greeting(client.receive())
        if not hmac.compare_digest(token, wire.mint(key)):
            raise Refusal("NOT_SECURED", "the token is not that of the present commander")
        if version != VERSION:
            raise Refusal("VERSION_MISMATCH", f"the client speaks version {version} of the wire, this kit {VERSION}")
    except Refusal as refusal:
        client.send(wire.encode("Denied", code=refusal.code, message=str(refusal)))
        raise ConnectionRefusedError from refusal
    client.send(wire.encode("Welcome", version=VERSION, max_bytes=MESSAGE_MAX_BYTES))


def main(make_body: Callable[[], Body], arguments: Sequence[str] | None = None) -> None:
    """Serve a body as the command line says, or `arguments` in its place."""
    parser = argparse.ArgumentParser(description="Serve a body; its key is the first line of standard input.")
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--certificate", help="PEM file of certificate chain and private key")
    parser.add_argument("--log", help="receive log, appended to")
    parser.add_argument("--stop-file", help="while it exists the emergency stop is set")
    given = parser.parse_args(arguments)
    key = bytes.fromhex(sys.stdin.readline().strip())
    try:
        body, ended = make_body(), threading.Event()
    except Exception as error:  # told where the endpoint would be, for who started this
        print(f"{type(error).__name__}: {error}".replace("\n", " "), flush=True)
        raise

    def end_with_parent() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=end_with_parent, daemon=True).start()
    serve_body(body, key, on_open=lambda endpoint: print(endpoint, flush=True), ended=ended, **vars(given))
