"""An OpenAI-compatible server.

It connects to its URL only: redirects and proxies of the environment are not followed. A whole answer is bounded in
time and size.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import msgspec

from phyagentos.clock import Clock
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
        clock: Bounds the wait.
        key: Sent as a bearer token; empty sends none.
        timeout_s: Longest wait for one whole answer, by the wall clock [s].
    """

    url: str
    model: str
    clock: Clock
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
        import httpx  # late: only who asks needs it

        until_s = self.clock.now_s() + self.timeout_s
        headers = {"Authorization": f"Bearer {self.key}"} if self.key else {}
        url = f"{self.url.rstrip('/')}/chat/completions"
        data = bytearray()
        try:
            with (
                httpx.Client(timeout=self.timeout_s, trust_env=False, follow_redirects=False) as client,
                client.stream("post", url, json=body, headers=headers) as response,
            ):
                if response.status_code != httpx.codes.OK:
                    raise ExecutionError("MODEL_REFUSED", f"{self.name} answered with status {response.status_code}")
                for part in response.iter_bytes():
                    data += part
                    if len(data) > MAX_BYTES:
                        raise ExecutionError(
                            "MODEL_MALFORMED", f"{self.name} answered with more than {MAX_BYTES} bytes"
                        )
                    if self.clock.now_s() > until_s:
                        raise ExecutionError("MODEL_UNREACHABLE", f"{self.name}: unfinished after {self.timeout_s:g} s")
        except (httpx.HTTPError, httpx.InvalidURL) as error:
            raise ExecutionError("MODEL_UNREACHABLE", f"{self.name}: {type(error).__name__} {error}".strip()) from error
        return bytes(data)
