"""Only requests with the token pass."""

import asyncio

import pytest

from phyagentos.mcp.protocol_server import TokenGate

TOKEN = "t" * 43


def ask(headers, kind="http"):
    """Whether the application was reached, and the messages that were sent."""
    reached, sent = [], []

    async def application(scope, receive, send):
        reached.append(scope)

    async def send(message):
        sent.append(message)

    asyncio.run(TokenGate(application, TOKEN)({"type": kind, "headers": headers}, None, send))
    return bool(reached), sent


def test_the_token_passes():
    assert ask([(b"Authorization", f"Bearer {TOKEN}".encode())]) == (True, [])


@pytest.mark.parametrize(
    "headers",
    [
        [],
        [(b"authorization", TOKEN.encode())],
        [(b"authorization", b"Bearer ")],
        [(b"authorization", f"Bearer {TOKEN}x".encode())],
        [(b"authorization", f"Bearer {TOKEN[:-1]}".encode())],
        [(b"authorization", f"bearer {TOKEN}".encode())],
        [(b"authorization", b"Bearer \xff")],
        [(b"authorization", f"Bearer {TOKEN}".encode()), (b"authorization", b"Bearer x")],
    ],
)
def test_anything_else_is_answered_401(headers):
    was_reached, sent = ask(headers)
    assert not was_reached
    assert sent[0]["status"] == 401


def test_a_web_socket_is_closed():
    assert ask([(b"authorization", f"Bearer {TOKEN}".encode())], "websocket")[1][0]["type"] == "websocket.close"
