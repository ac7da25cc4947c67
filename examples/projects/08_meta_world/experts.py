"""Serves Meta-World's scripted experts, or what was learnt of them, over openpi's wire, from their environment.

    build/metaworld/bin/python examples/projects/08_meta_world/experts.py [--port 8765] [--clones clones.npz]

The words of a session name its task: "drawer close" is asked of the expert of `drawer-close-v3`. An expert sees the
environment's observation (39,) and answers with one action (4,): three changes in hundredths of a metre, and the effort
of the fingers, 1 closing. With `--clones`, networks that `clone.py` has trained answer instead.
"""

import argparse
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import clone
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


Act = Callable[[NDArray[Any]], NDArray[Any]]


def list_experts() -> dict[str, Act]:
    """By task; they have no memory."""
    return {task: expert().get_action for task, expert in ENV_POLICY_MAP.items()}


def read_clones(path: Path) -> dict[str, Act]:
    """The networks of a file, by task."""
    nets: dict[str, dict[str, NDArray[Any]]] = {}
    with np.load(path) as arrays:
        for key, array in arrays.items():
            task, name = key.split("/")
            nets.setdefault(task, {})[name] = array.astype(np.float64)
    return {task: partial(clone.apply, net) for task, net in nets.items()}


def receive(known: Mapping[str, Act], connection: ServerConnection) -> None:
    """One episode."""
    connection.send(msgpack.packb({"policy": "metaworld/experts"}))
    try:
        for message in connection:
            asked = msgpack.unpackb(message)
            task = f"{asked['prompt'].replace(' ', '-')}-v3"
            if task not in known:
                connection.send(f"nothing is known of {task!r}; there are {', '.join(sorted(known))}")
                continue
            action = np.clip(known[task](decode(asked["observation/state"])), -1.0, 1.0)
            connection.send(msgpack.packb({"actions": encode(action.astype(np.float64)[None])}))
    except ConnectionClosed:
        return


def main() -> None:
    """Serve until interrupted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, default=8765)
    parser.add_argument("--clones", type=Path, help="weights of `clone.py`")
    given = parser.parse_args()
    known = read_clones(given.clones) if given.clones else list_experts()
    with serve(partial(receive, known), "127.0.0.1", given.port, compression=None) as server:
        server.serve_forever()


if __name__ == "__main__":
    main()
