"""An OpenAI-compatible server.

It connects to its URL only: redirects and proxies of the environment are not followed. A whole answer is bounded in
time and size (see `network.http`).
"""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import msgspec

from phyagentos.errors import ExecutionError

MAX_BYTES = 256 * 1024  # of an answer; the one that is asked for has two fields


class _Message(msgspec.Struct, frozen=True):
    content: str


class _Choice(msgspec.Struct, frozen=True):
    message: _Message


class _Completion(msgspec.Struct, frozen=True):
    choices: tuple[_Choice, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenAiEndpoint:
    """One model behind `<url>/chat/completions`.

    Attributes:
        url: Base, up to `/v1`.
        key: Sent as a bearer token; empty sends none.
        timeout_s: Longest wait for one whole answer, by the wall clock [s].
    """

    url: str
    model: str
    key: str = field(default="", repr=False)
    timeout_s: float = 20.0

    @property
    def name(self) -> str:
        """Model and host, as recorded; never the key."""
        return f"{self.model} at {urlsplit(self.url).hostname}"

    def complete(self, messages: Sequence[dict[str, Any]]) -> str:
        """The text of the answer.

        Raises:
            ExecutionError: `MODEL_UNREACHABLE` (also when it answers too late), `MODEL_REFUSED` (a status other than
                200) or `MODEL_MALFORMED`.
        """
        data = self._post(
            {
                "model": self.model,
                "messages": list(messages),
                "temperature": 0,
                "max_tokens": 200,
                "response_format": {"type": "json_object"},
            }
        )
        try:
            return msgspec.json.decode(data, type=_Completion).choices[0].message.content
        except (msgspec.MsgspecError, UnicodeError, IndexError) as error:
            raise ExecutionError("MODEL_MALFORMED", f"{self.name}: no completion in its answer: {error}") from error

    def _post(self, body: dict[str, Any]) -> bytes:
        from phyagentos.network.http import Codes, HttpClient  # late: only who asks needs it

        lost = "MODEL_UNREACHABLE"
        codes = Codes(late=lost, lost=lost, refused="MODEL_REFUSED", malformed="MODEL_MALFORMED")
        url = f"{self.url.rstrip('/')}/chat/completions"
        headers = [("Content-Type", "application/json")]
        if self.key:
            headers.append(("Authorization", f"Bearer {self.key}"))
        with contextlib.closing(HttpClient(url, codes, self.name)) as client:
            return client.post(
                msgspec.json.encode(body), timeout_s=self.timeout_s, max_bytes=MAX_BYTES, headers=headers
            )
