"""A server of language models over a real socket: it answers what a test says, in turn, and keeps what it was asked."""

import contextlib
import json
import threading
from collections.abc import Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import yaml

from phyagentos.protocol.documents.document import iter_blocks


class ChatServer(ThreadingHTTPServer):
    """Gives its answers one after the other, the last one again and again.

    Args:
        answers: Texts of messages; other values are given as their JSON.
        tokens: Usage that each answer states.
        delay_s: Silence before each answer [s].
        status: Of every answer; a redirection leads to another path of this server.
        body: Sent in place of an answer.
    """

    daemon_threads = True

    def __init__(
        self,
        answers: Sequence[object],
        tokens: int = 0,
        delay_s: float = 0.0,
        status: int = 200,
        body: bytes | None = None,
    ) -> None:
        super().__init__(("127.0.0.1", 0), _Answering)
        self.answers, self.tokens, self.delay_s, self.status, self.body = list(answers), tokens, delay_s, status, body
        self.asked: list[dict] = []
        self.keys: list[str | None] = []
        self.closed = threading.Event()
        threading.Thread(target=self.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/v1"

    @property
    def data(self) -> dict:
        """What the first question said in its user's message: heading -> items."""
        text = self.asked[0]["messages"][1]["content"]
        return {block.name: yaml.safe_load(block.yaml) for block in iter_blocks(text)}

    def close(self) -> None:
        self.closed.set()
        self.shutdown()
        self.server_close()


class _Answering(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        server = self.server
        asked = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        server.asked.append(asked | {"path": self.path})
        server.keys.append(self.headers.get("Authorization"))
        server.closed.wait(server.delay_s)
        found = server.answers[min(len(server.asked), len(server.answers)) - 1]
        text = found if isinstance(found, str) else json.dumps(found)
        body = {"choices": [{"message": {"content": text}}], "usage": {"total_tokens": server.tokens}}
        data = json.dumps(body).encode() if server.body is None else server.body
        self.send_response(server.status)
        if 300 <= server.status < 400:
            self.send_header("Location", f"{server.url}/elsewhere")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        with contextlib.suppress(OSError):
            self.wfile.write(data)

    def log_message(self, *_: object) -> None:
        pass
