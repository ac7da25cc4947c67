"""A vision model that cannot be relied on, behind an OpenAI-compatible endpoint; its manner stands in the path."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

ANSWERS = {
    "judge_raves": "Certainly! The picture shows a lovely table.",
    "judge_denies": json.dumps({"truth": "false", "because": "I see no tray in the second picture."}),
}
"""Manner -> what it answers to every question. Any other manner is answered with an error of the server."""


class _Handler(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        self.rfile.read(int(self.headers["Content-Length"]))
        manner = self.path.split("/")[1]
        content = ANSWERS.get(manner)
        body = json.dumps({"choices": [{"message": {"role": "assistant", "content": content or ""}}]}).encode()
        self.send_response(503 if content is None else 200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@contextmanager
def serve_model() -> Iterator[str]:
    """The endpoint's address, up to the manner."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()
