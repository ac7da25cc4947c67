"""Sensors and perception against target and skill: whether what is needed is measured, in time and read by somebody.

Upstream: sensors.yaml, perception.yaml, the profile. Downstream: `compatibility`.
"""

from collections.abc import Iterator

from phyagentos.errors import Problem, format_names
from phyagentos.protocol.perception import Perception
from phyagentos.protocol.runtime_contract import RuntimeContract
from phyagentos.protocol.sensors import Modality, Sensor, Sensors, find_sensor
from phyagentos.protocol.skill_runtimes import SkillRuntime
from phyagentos.protocol.targets import TargetProfile
from phyagentos.runtime.preflight.findings import make_problem

RATE_TOLERANCE = 1e-6  # 1 / 0.02 is not exactly 50
BODY_FRAMES = ("world", "base", "tcp")
MODALITIES: dict[str, Modality] = {  # of what this project's targets measure, by its usual name
    "joint_state": "proprioception",
    "gripper_width": "proprioception",
    "entity_poses": "simulator_state",
    "regions": "simulator_state",
    "camera_rgb": "rgb",
    "camera_depth": "depth",
    "contact": "contact",
}


def iter_sensing_problems(
    skill: SkillRuntime, profile: TargetProfile, sensors: Sensors, perception: Perception, contract: RuntimeContract
) -> Iterator[Problem]:
    """What a skill observes, followed from the target through a sensor and a pipeline."""
    by = f"skill {skill.skill}: needs.observations"
    read = {sensor for pipeline in perception.pipelines.values() for sensor in pipeline.sensors}
    used: dict[str, Sensor] = {}
    for need in skill.needs.observations:
        found = find_sensor(sensors, need)
        if found is None:
            known = sorted({name for sensor in sensors.sensors.values() for name in sensor.provides})
            fix = f"Let a sensor of sensors.yaml provide {need!r}."
            address = "sensors.yaml: sensors"
            yield make_problem("SENSOR_MISSING", address, repr(need), format_names(known), triggered_by=by, fix=fix)
        else:
            used[found[0]] = found[1]
    for name, sensor in used.items():
        if name not in read:
            fix = f"Name {name!r} in the pipeline that it feeds, or needs nothing of it."
            address = "perception.yaml: pipelines"
            yield make_problem("SENSOR_UNREAD", address, repr(name), format_names(read), triggered_by=by, fix=fix)
        yield from iter_sensor_problems(name, sensor, profile, contract, by)


def iter_sensor_problems(
    name: str, sensor: Sensor, profile: TargetProfile, contract: RuntimeContract, triggered_by: str
) -> Iterator[Problem]:
    """Modality and rate of one sensor."""
    place = f"sensors.yaml: sensors.{name}"
    for each in sensor.provides:
        usual = MODALITIES.get(each, sensor.modality)
        both = sensor.modality == "rgbd" and usual in ("rgb", "depth")
        if sensor.modality != usual and not both:
            address = f"{place}.modality"
            yield make_problem(
                "SENSOR_MODALITY", address, sensor.modality, f"{usual}, for {each!r}", triggered_by=triggered_by
            )
    if sensor.modality == "simulator_state" and profile.kind == "real_robot":
        fix = "A real robot has no simulator; use a camera."
        yield make_problem(
            "SENSOR_MODALITY", f"{place}.modality", sensor.modality, "a sensor of the robot", fix=fix,
            triggered_by=triggered_by,
        )  # fmt: skip
    fastest_hz = 1.0 / profile.physics_step_s
    if sensor.rate_hz < contract.sampling_hz * (1.0 - RATE_TOLERANCE):
        fix = "Conditions are sampled more often than this sensor measures."
        yield make_problem(
            "SENSOR_RATE", f"{place}.rate_hz", sensor.rate_hz, f"at least {contract.sampling_hz:g} Hz", fix=fix,
            triggered_by="runtime_contract.yaml: sampling_hz",
        )  # fmt: skip
    elif sensor.rate_hz > fastest_hz * (1.0 + RATE_TOLERANCE):
        fix = "Nothing new can be measured between two steps of the physics."
        yield make_problem(
            "SENSOR_RATE", f"{place}.rate_hz", sensor.rate_hz, f"at most {fastest_hz:g} Hz", fix=fix,
            triggered_by=f"target {profile.target}: physics_step_s",
        )  # fmt: skip


def iter_frame_problems(skill: SkillRuntime, sensors: Sensors, cameras: tuple[str, ...]) -> Iterator[Problem]:
    """Sensors whose frame nobody knows; the live target knows its cameras."""
    known = (*BODY_FRAMES, *cameras)
    for need in skill.needs.observations:
        found = find_sensor(sensors, need)
        if found is not None and found[1].frame not in known:
            address = f"sensors.yaml: sensors.{found[0]}.frame"
            by = f"skill {skill.skill}: needs.observations"
            yield make_problem("FRAME_UNKNOWN", address, repr(found[1].frame), format_names(known), triggered_by=by)
