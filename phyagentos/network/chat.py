"""An OpenAI-compatible server of language or vision-language models; the caller bounds what an answer may cost.

It connects to its URL only: redirects and proxies of the environment are not followed. A whole answer is bounded in
time and size (see `network.http`).
"""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import msgspec

from phyagentos.errors import ExecutionError

MAX_BYTES = 256 * 1024  # of an answer
SHORT_TOKENS = 200  # of an answer with two fields
JSON_OBJECT = {"type": "json_object"}


class _Answer(msgspec.Struct, frozen=True):
    choices: tuple[dict[str, Any], ...]
    usage: dict[str, Any] | None = None


class Completion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An answer; `tokens` of question and answer, as the server counts them, 0 where it does not."""

    text: str
    tokens: int = 0


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

    def complete(
        self,
        messages: Sequence[Mapping[str, Any]],
        *,
        max_tokens: int = SHORT_TOKENS,
        response_format: Mapping[str, Any] = JSON_OBJECT,
        timeout_s: float | None = None,
    ) -> Completion:
        """One answer, of at most `max_tokens`; a server may ignore the form asked for, so it is to be checked.

        `timeout_s` [s] is instead of that of the endpoint.

        Raises:
            ExecutionError: `MODEL_FAILED`: no answer in time, a status other than 200, or another form.
        """
        from phyagentos.network.http import HttpClient  # late: only who asks needs it

        body = {
            "model": self.model,
            "messages": list(messages),
            "temperature": 0,
            "max_tokens": max_tokens,
            "response_format": response_format,
        }
        within_s = self.timeout_s if timeout_s is None else timeout_s
        url = f"{self.url.rstrip('/')}/chat/completions"
        headers = [("Content-Type", "application/json")]
        if self.key:
            headers.append(("Authorization", f"Bearer {self.key}"))
        with contextlib.closing(HttpClient(url, "MODEL_FAILED", name=self.name)) as client:
            sent = msgspec.json.encode(body)
            data = client.post(sent, timeout_s=within_s, max_bytes=MAX_BYTES, headers=headers)
        try:
            answer = msgspec.json.decode(data, type=_Answer)
            found = {
                "text": answer.choices[0]["message"]["content"],
                "tokens": (answer.usage or {}).get("total_tokens", 0),
            }
            return msgspec.convert(found, Completion)
        except (msgspec.MsgspecError, UnicodeError, LookupError, TypeError) as error:
            raise ExecutionError("MODEL_FAILED", f"{self.name}: no completion in its answer: {error}") from error
