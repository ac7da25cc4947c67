"""A bare loop over an environment, in its own Python, with the actions of a session: how long each `env.step` took.

    python bare.py < JSON      # {"world", "settings", "scene", "seed", "rows", "is_whole"}; prints a list [ms] as JSON

Where LIBERO's environment `is_whole` it is as its owner makes it, with the observations that the kit's body leaves out.
The kit's body turns each row of set-points into an action, as on the path; what that takes is not counted.
"""

import json
import sys
import time
from typing import Any


def open_body(world: str, settings: dict[str, Any]) -> Any:
    """The body of the kit."""
    if world == "libero":
        from target_server import libero_body

        return libero_body.LiberoBody(libero_body.Settings(**settings))
    from target_server import gymnasium_body

    return gymnasium_body.GymnasiumBody(gymnasium_body.make_settings(settings))


def main() -> None:
    """Read what is asked for, and time it."""
    asked = json.load(sys.stdin)
    body, took_ms = open_body(asked["world"], asked["settings"]), list[float]()
    body.load(asked["scene"], asked["seed"], b"")
    if asked["world"] == "libero":
        body.build_observations(asked["is_whole"])
    step = body._env.step

    def time_step(action: Any) -> Any:
        began_s = time.perf_counter()
        result = step(action)
        took_ms.append(1e3 * (time.perf_counter() - began_s))
        return result

    body._env.step = time_step
    for q, qd, width_m in asked["rows"]:
        body.step(q, qd, width_m)
    print(json.dumps(took_ms))


if __name__ == "__main__":
    main()
