"""Health of a camera: its frames arrive, advance in time, and do not repeat the same picture.

The noise of a real sensor never repeats: two pictures that are equal bit for bit are one. Between whole pictures a
small window of each camera is probed now and then, which detects a frozen camera before the next look. A sensor without
declared noise may show a still scene twice; it is frozen where its picture stays although the robot has moved in it
(`motion_in_view`).
"""

import hashlib
from collections.abc import Callable, Mapping

import msgspec
import numpy as np

from phyagentos.protocol.world.environment import SensorHealth
from phyagentos.runtime.targets.wire import Crop, Frame, Frames

Proof = Callable[[Frame, SensorHealth], bool]
"""Whether a live camera would now show another picture than the one that this health remembers."""

SAME_S = 1e-6  # stamps this near to each other are one
AHEAD_S = 0.005  # no frame is from the future
PROBE_PX = 12  # side of the window in the middle of a picture: a few hundred numbers with noise never repeat
REPEATED = "a new stamp on the same picture"


def assess(
    frames: Frames,
    before: Mapping[str, SensorHealth],
    now_s: float,
    max_age_s: float,
    would_differ: Proof = lambda _frame, _was: True,
    joints_rad: Callable[[float], tuple[float, ...]] = lambda _time_s: (),
) -> tuple[tuple[Frame, ...], dict[str, SensorHealth]]:
    """The frames of healthy cameras, at most `max_age_s` old, and the health of every camera.

    The robot's `joints_rad` at the time of a picture are remembered with it.
    """
    health = dict(before)
    believed: list[Frame] = []
    for camera, code in frames.missing.items():
        health[camera] = _turn(before.get(camera), "missing", now_s, code)
    for frame in frames.frames:
        was, digest = before.get(frame.camera), compute_digest(frame)
        status, detail = _judge(frame, digest, was, now_s, max_age_s, would_differ)
        turned = _turn(was, status, now_s, detail)
        repeats = was is not None and was.digest == digest
        health[frame.camera] = msgspec.structs.replace(
            turned,
            time_s=frame.time_s,
            digest=digest,
            shown_rad=turned.shown_rad if repeats else joints_rad(frame.time_s),
            pose=turned.pose if repeats else frame.world_T_camera,
            focal_px=(frame.fx, frame.fy, frame.cx, frame.cy),
            size_px=(frame.width, frame.height),
        )
        if status == "live":
            believed.append(frame)
    return tuple(believed), health


def find_probe_regions(health: Mapping[str, SensorHealth]) -> dict[str, Crop]:
    """The probe windows: the middle of every picture whose size is known."""
    return {
        camera: (each.size_px[0] // 2 - PROBE_PX // 2, each.size_px[1] // 2 - PROBE_PX // 2, PROBE_PX, PROBE_PX)
        for camera, each in health.items()
        if min(each.size_px) >= PROBE_PX
    }


def check_probes(frames: Frames, before: Mapping[str, SensorHealth], now_s: float) -> dict[str, SensorHealth]:
    """Health of the cameras by these windows: one that repeats with a new stamp is of a frozen camera."""
    health = {camera: msgspec.structs.replace(each, probed_s=now_s) for camera, each in before.items()}
    for frame in frames.frames:
        was = health.get(frame.camera)
        if was is None:
            continue  # not asked for
        if not np.isfinite(frame.depth_m).any():
            health[frame.camera] = msgspec.structs.replace(was, liveness_probe="")  # darkness repeats
            continue
        digest, _, stamp = was.liveness_probe.partition("@")
        if stamp and frame.time_s <= float(stamp) + SAME_S:
            continue  # the same frame once more: the next ones were lost
        now = compute_digest(frame)
        if now == digest:
            was = _turn(was, "frozen", now_s, REPEATED)
        elif was.status == "frozen":
            was = _turn(was, "live", now_s, "")
        health[frame.camera] = msgspec.structs.replace(was, liveness_probe=f"{now}@{frame.time_s:.6f}")
    return health


def compute_digest(frame: Frame) -> str:
    """Hash of a picture."""
    digest = hashlib.blake2b(frame.rgb.tobytes(), digest_size=12)
    digest.update(frame.depth_m.tobytes())
    return digest.hexdigest()


def _judge(
    frame: Frame, digest: str, was: SensorHealth | None, now_s: float, max_age_s: float, would_differ: Proof
) -> tuple[str, str]:
    age_s = now_s - frame.time_s
    if not age_s <= max_age_s:  # also when its stamp is no number
        return "stale", f"its latest frame is {age_s:.2f} s old"
    if age_s < -AHEAD_S:
        return "stale", f"its frame is dated {-age_s:.2f} s ahead"
    if not np.isfinite(frame.depth_m).any():
        return "dark", "no depth at all"
    if was is None:
        return "live", ""
    if was.status == "frozen" and (was.liveness_probe or was.digest == digest):
        return "frozen", REPEATED
    if was.digest == digest and frame.time_s > was.time_s + SAME_S and would_differ(frame, was):
        return "frozen", REPEATED
    return "live", ""


def _turn(was: SensorHealth | None, status: str, now_s: float, detail: str) -> SensorHealth:
    """A camera that enters a status, or is still in it."""
    since_s = was.since_s if was is not None and was.status == status else now_s
    return msgspec.structs.replace(was or SensorHealth(), status=status, since_s=since_s, detail=detail)
