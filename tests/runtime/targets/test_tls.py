"""TLS to a target that is served elsewhere: by the framework and by the kit; never without it to another machine."""

import pytest

from phyagentos.assembly.processes import open_door
from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.handshake import greet, mint
from phyagentos.runtime.targets.websocket import WebSocketDoor, connect_websocket
from tests.certificates import make_certificate
from tests.served_kit import Served


@pytest.mark.slow
def test_a_door_with_a_certificate_speaks_tls_to_who_trusts_it(tmp_path):
    both, alone = make_certificate(tmp_path)
    door = WebSocketDoor(certificate=both)
    assert door.endpoint.startswith("wss://127.0.0.1:")
    channel = connect_websocket(door.endpoint, alone)
    client = door.accept()
    channel.send_bytes(b"a message")
    assert client.recv_bytes() == b"a message"
    for each in (channel, client):
        each.close()
    _, another = make_certificate(tmp_path, "another")
    for trusted, by in ((None, "an authority of this system"), (another, str(another))):
        with pytest.raises(
            DefinitionError, match=f"NOT_SECURED: found self-signed certificate; expected signed by {by}"
        ):
            connect_websocket(door.endpoint, trusted)
    with pytest.raises(ExecutionError, match="TARGET_LOST: no target answers at ws:"):
        connect_websocket(door.endpoint.replace("wss:", "ws:"))
    with pytest.raises(DefinitionError, match="NOT_SECURED: found Hostname mismatch"):
        connect_websocket(door.endpoint.replace("127.0.0.1", "localhost"), alone)
    door.close()


@pytest.mark.slow
def test_the_kit_speaks_tls(tmp_path):
    both, alone = make_certificate(tmp_path)
    served = Served(tmp_path, options=("--certificate", str(both)))
    endpoint = served.start()
    try:
        channel = connect_websocket(endpoint, alone)
        greet(channel, mint(served.key))

        assert endpoint.startswith("wss://")
        assert isinstance(wire.exchange(channel, wire.Describe(), 5.0), wire.Description)
        channel.close()
    finally:
        served.close()


@pytest.mark.parametrize("host", ["192.0.2.1", "robot.example", "0.0.0.0"])
def test_another_machine_is_neither_served_nor_reached_without_tls(host):
    with pytest.raises(DefinitionError, match=f"NOT_SECURED: found host '{host}' without TLS; expected wss://"):
        connect_websocket(f"ws://{host}:7000")
    with pytest.raises(DefinitionError, match="NOT_SECURED"):
        WebSocketDoor(host)


def test_a_door_that_is_asked_for_tls_is_never_opened_without():
    with pytest.raises(DefinitionError, match="NOT_SECURED: found no --certificate"):
        open_door("wss://127.0.0.1:0")
