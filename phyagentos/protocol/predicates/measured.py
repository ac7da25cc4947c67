"""Names of what is measured during a session, as `metric(name)` compares it; the judge of metrics reads it."""

from phyagentos.protocol.predicates.predicate import iter_metrics

REPORTED = "reported_"  # begins the name of a number that is the controller's own word
METRICS = (
    "final_joint_speed_rad_s",
    "final_tracking_error_rad",
    "final_rest_s",
    "final_gripper_width_m",
    "peak_joint_speed_rad_s",
    "peak_joint_acceleration_rad_s2",
    "peak_tracking_error_rad",
    "peak_force_n",
    "peak_force_n_error",
    "sim_time_s",
    "ticks",
    "interventions",
)


def list_measured(text: str) -> list[str]:
    """Metrics that a predicate compares, but for those that a controller reports of itself."""
    return [name for name in iter_metrics(text) if not name.startswith(REPORTED)]
