"""Policies that are served in a thread of this process, and clients that wait for their chunk."""

import queue
import threading


def serve(serve_so, policy, descriptor):
    """Serve a policy by `serve_policy` or `serve_openpi` until this process ends; the endpoint."""
    found = queue.SimpleQueue()
    threading.Thread(target=serve_so, args=(policy, descriptor, found.put), daemon=True).start()
    return found.get(timeout=10.0)


def take(client):
    """The chunk that a client has requested."""
    while (chunk := client.poll()) is None:
        client.wait(1.0)
    return chunk
