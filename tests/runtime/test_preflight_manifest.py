"""The handle lets through what the manifest of the session holds, and nothing else."""

import pytest

from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.settings.operations import SESSION_OPERATIONS
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.runtime.actions.handle import OPERATIONS, CommandRefused, TargetSessionHandle
from phyagentos.runtime.targets import wire

LIMITS = read_safety(find_shipped_root() / "protocol/safety.yaml").targets["panda"]


class Wire:
    """Keeps what passes."""

    def __init__(self) -> None:
        self.sent = []

    def send_bytes(self, data) -> None:
        self.sent.append(data)
        raise OSError("nobody is there")


def test_every_operation_of_a_session_has_a_door():
    assert {*OPERATIONS.values(), wire.RENDER} == set(SESSION_OPERATIONS)


def test_what_the_manifest_does_not_hold_never_reaches_the_wire():
    connection = Wire()
    handle = TargetSessionHandle(connection, LIMITS)
    handle.permit(("apply", "observe", "halt", "settle"))

    with pytest.raises(CommandRefused, match="'render' is not in the manifest") as refused:
        handle.render("top")

    assert refused.value.code == "NOT_PERMITTED"
    assert refused.value.by == "handle"
    assert not handle.permits("render")
    assert connection.sent == []


def test_what_the_manifest_holds_is_asked_for():
    connection = Wire()
    handle = TargetSessionHandle(connection, LIMITS)
    handle.permit(("observe",))

    with pytest.raises(Exception, match="TARGET_LOST"):
        handle.observe()

    assert len(connection.sent) == 1
    assert wire.Observe in OPERATIONS


def test_halting_is_never_refused():
    handle = TargetSessionHandle(Wire(), LIMITS)
    handle.permit(())

    assert handle.permits("halt")
    assert not handle.permits("apply")
