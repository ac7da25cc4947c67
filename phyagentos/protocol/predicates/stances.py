"""How a robot stands: its joints in a named posture, its body upright."""

from phyagentos.errors import format_names
from phyagentos.geometry import compute_tilt
from phyagentos.protocol.predicates.library import UNCERTAINTY_STDS, FactUnknown, Reading
from phyagentos.protocol.predicates.view import View
from phyagentos.wording import compare_angles, compare_lengths, format_angle

UPRIGHT_RAD = 0.26  # 15 degrees: a bottle leaning on a wall does not stand
POSTURE_RAD = 0.05  # the error of a servo that carries a load stays below


def measure_in_posture(view: View, target: str, posture: str, tol_rad: float) -> Reading:
    """Every joint, as measured, within `tol_rad` of a posture that its profile names; a base may be anywhere."""
    state = view.now.targets.get(target)
    if state is None:
        raise FactUnknown(f"target {target} is not in the snapshot")
    if posture not in state.postures:
        raise FactUnknown(f"{target} has no posture {posture!r}; it has {format_names(state.postures)}")
    wanted = state.postures[posture]
    own = state.q_rad if state.base is None else state.q_rad[len(state.base) :]
    off_rad = [abs(is_at - asked) for is_at, asked in zip(own, wanted, strict=True)]
    worst_rad = max(off_rad)
    joint = off_rad.index(worst_rad) + 1 + len(state.q_rad) - len(own)
    off, most = compare_angles(worst_rad, tol_rad)
    because = f"joint {joint} of {target} is {off} from {posture}; up to {most} is allowed"
    scale_rad = max(tol_rad, 1e-3)
    measured: dict[str, float | str | bool] = {"joint": joint, "off_rad": round(worst_rad, 5)}
    return Reading((tol_rad - worst_rad) / scale_rad, measured, because, UNCERTAINTY_STDS * state.q_std_rad / scale_rad)


def measure_standing(view: View, target: str, least_m: float) -> Reading:
    """The body of its base is upright within 15 degrees, and its frame at least so high in the world."""
    state = view.now.targets.get(target)
    if state is None or state.trunk is None:
        raise FactUnknown(f"how the base of {target} stands is not in the snapshot")
    tilt_rad, height_m = compute_tilt(state.trunk), state.trunk.position_m[2]
    height, least = compare_lengths(height_m, least_m)
    because = f"{target} leans {format_angle(tilt_rad)} at a height of {height}; at least {least} is wanted"
    margin = min(1.0 - tilt_rad / UPRIGHT_RAD, (height_m - least_m) / max(least_m, 1e-3))
    return Reading(margin, {"tilt_rad": round(tilt_rad, 5), "height_m": round(height_m, 5)}, because)
