"""A bare loop over an environment, in its own Python: prints how long each step took [ms], as JSON.

    python bare.py meta_world TASK STEPS SEED        python bare.py libero SUITE/NUMBER STEPS SEED
"""

import json
import sys
import time

import numpy as np


def open_meta_world(task, seed):
    """The environment, begun anew, and the length of its actions."""
    import gymnasium
    import metaworld  # noqa: F401 - registers it

    env = gymnasium.make("Meta-World/MT1", env_name=task, seed=seed, disable_env_checker=True)
    env.reset(seed=seed)
    return env, 4


def open_libero(scene, seed):
    """As the target of the kit opens it."""
    from target_server.libero_body import LiberoBody, Settings

    body = LiberoBody(Settings("libero", scene, [1.0] * 7))
    body.load(scene, seed, b"")
    return body._env, 7


def main():
    world, name, steps, seed = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    env, width = {"meta_world": open_meta_world, "libero": open_libero}[world](name, seed)
    took_ms = []
    for step in range(steps):
        action = np.zeros(width, dtype=np.float32)
        action[:3] = 0.3 * np.sin(0.1 * step + np.arange(3))
        action[-1] = -1.0
        began_s = time.perf_counter()
        env.step(action)
        took_ms.append(1e3 * (time.perf_counter() - began_s))
    print(json.dumps(took_ms))


if __name__ == "__main__":
    main()
