"""What goes wrong in a goal: objects, motors and cameras, as entries of a fault file."""

from collections.abc import Iterator

from benchmarks.worlds.forms import Rng

CAMERAS = ("overhead", "left", "right", "wrist")
KINDS = ("slip", "nudge", "move", "remove", "stall", "freeze", "blackout", "misdate", "miscalibrate")


def draw_faults(rng: Rng, moved: list[str]) -> Iterator[dict[str, object]]:
    """One fault of an object, a motor or a camera; with sensors more may lie at once."""
    item = moved[int(rng.integers(len(moved)))]
    kind = str(rng.choice(KINDS))
    near = {"gripper_near_m": round(float(rng.uniform(0.04, 0.25)), 3)}
    if kind == "slip":
        yield {"kind": kind, "object": item, "when": {"lifted_m": round(float(rng.uniform(0.05, 0.12)), 3)}}
    elif kind in {"nudge", "move", "remove"}:
        yield {"kind": kind, "object": item, "when": near}
    elif kind == "stall":
        yield {"kind": kind, "joint": f"joint{int(rng.integers(1, 7))}", "object": item, "when": near}
    else:
        cameras = list(rng.choice([*CAMERAS, "*"], size=int(rng.integers(1, 3)), replace=False))
        for camera in cameras:
            yield _draw_lie(kind, str(camera), rng)


def _draw_lie(kind: str, camera: str, rng: Rng) -> dict[str, object]:
    begins = {"time_s": round(float(rng.uniform(0.5, 8.0)), 2)}
    one: dict[str, object] = {"kind": kind, "camera": camera, "when": begins}
    if kind == "freeze":
        one["stamp"] = str(rng.choice(["fresh", "stale"]))
    elif kind == "blackout":
        one["mode"] = str(rng.choice(["dark", "silent"]))
    elif kind == "misdate":
        one["by_s"] = round(float(rng.choice([-1, 1]) * rng.uniform(0.3, 6.0)), 2)
    else:
        one["by_m"] = [round(float(value), 4) for value in rng.uniform(-0.04, 0.04, 3)]
        one["by_rad"] = [round(float(value), 4) for value in rng.uniform(-0.03, 0.03, 3)]
        one["when"] = {}
    return one


def find_struck(fault: dict[str, object]) -> str:
    """What a fault strikes: an object, a camera (`*`: every one) or a joint."""
    return str(fault.get("joint") or fault.get("object") or fault.get("camera"))


def is_lasting(fault: dict[str, object]) -> bool:
    """Whether a fault may leave a goal that nobody could meet: the object is gone, or no camera is to be believed."""
    return fault["kind"] == "remove" or fault.get("camera") == "*"
