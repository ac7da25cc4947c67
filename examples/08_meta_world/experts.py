"""Serves Meta-World's scripted experts over openpi's wire, from an environment that has them.

    build/metaworld/bin/python examples/08_meta_world/experts.py [--port 8765]

The words of a session name its task: "drawer close" is asked of the expert of `drawer-close-v3`. An expert sees the
environment's observation (39,) and answers with one action (4,): three changes in hundredths of a metre, and the effort
of the fingers, 1 closing.
"""

import argparse
from typing import Any

import msgpack
import numpy as np
from metaworld.policies import ENV_POLICY_MAP
from numpy.typing import NDArray
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve


def encode(array: NDArray[Any]) -> dict[bytes, Any]:
    """An array as openpi's messages have it."""
    return {b"__ndarray__": True, b"data": array.tobytes(), b"dtype": array.dtype.str, b"shape": array.shape}


def decode(value: dict[bytes, Any]) -> NDArray[Any]:
    """The array of such a map."""
    return np.frombuffer(value[b"data"], dtype=value[b"dtype"]).reshape(value[b"shape"]).copy()


def receive(connection: ServerConnection) -> None:
    """One episode."""
    connection.send(msgpack.packb({"policy": "metaworld/experts"}))
    experts: dict[str, Any] = {}
    try:
        for message in connection:
            asked = msgpack.unpackb(message)
            task = f"{asked['prompt'].replace(' ', '-')}-v3"
            if task not in ENV_POLICY_MAP:
                connection.send(f"no expert of {task!r}; there are {', '.join(sorted(ENV_POLICY_MAP))}")
                continue
            expert = experts.setdefault(task, ENV_POLICY_MAP[task]())
            action = expert.get_action(decode(asked["observation/state"]))
            connection.send(msgpack.packb({"actions": encode(np.clip(action, -1.0, 1.0).astype(np.float64)[None])}))
    except ConnectionClosed:
        return


def main() -> None:
    """Serve until interrupted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, default=8765)
    with serve(receive, "127.0.0.1", parser.parse_args().port, compression=None) as server:
        server.serve_forever()


if __name__ == "__main__":
    main()
