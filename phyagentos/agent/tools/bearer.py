"""A bearer token in front of an ASGI application; loads no web framework."""

import hmac
from collections.abc import Awaitable, Callable
from typing import Any

Application = Callable[[Any, Any, Any], Awaitable[None]]
"""An ASGI application: scope, receive, send."""


class TokenGate:
    """An ASGI application that answers 401 to every request without the token."""

    def __init__(self, application: Application, token: str) -> None:
        self._application, self._expected = application, f"Bearer {token}".encode("ascii")

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Pass on what belongs to the server itself, and requests with the token."""
        given = [value for name, value in scope.get("headers", ()) if name.lower() == b"authorization"]
        admits = scope["type"] == "http" and len(given) == 1 and hmac.compare_digest(given[0], self._expected)
        if admits or scope["type"] == "lifespan":
            await self._application(scope, receive, send)
        elif scope["type"] == "http":
            headers = [(b"www-authenticate", b"Bearer"), (b"content-length", b"0")]
            await send({"type": "http.response.start", "status": 401, "headers": headers})
            await send({"type": "http.response.body", "body": b""})
        else:
            await send({"type": "websocket.close", "code": 1008})
