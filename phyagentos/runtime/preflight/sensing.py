"""Sensors and perception against target and skill: whether each needed stream is measured, in time, and consumed."""

from collections.abc import Iterator

from phyagentos.errors import Problem, format_names
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.settings.perception import Perception, Sensing
from phyagentos.protocol.settings.runtime_contract import RuntimeContract
from phyagentos.protocol.settings.sensors import Modality, Sensor, Sensors, find_sensor
from phyagentos.runtime.preflight.findings import make_problem

PERCEIVED = {"entity_poses": "entities", "regions": "regions"}
"""Observations that perception makes out of cameras, by the names of what its pipelines produce."""
_SAMPLED: frozenset[Modality] = frozenset({"simulator_state", "proprioception", "contact"})
"""What conditions are sampled from as it is measured; what is perceived has an age, which predicates heed."""
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
    """The observations of a skill, followed from the target through a sensor and a pipeline."""
    by = f"skill {skill.skill}: needs.observations"
    read = {sensor for pipeline in perception.pipelines.values() for sensor in pipeline.sensors}
    used: dict[str, Sensor] = {}
    for need in skill.needs.observations:
        found = find_sources(need, sensors, perception)
        if not found:
            yield _make_missing(need, sensors, perception, by)
        elif _is_perceived(need, perception):
            yield from _iter_freshness_problems(found, perception, by)
        used |= found
    for name, sensor in used.items():
        if name not in read:
            yield make_problem(
                "OBSERVATION_MISMATCH",
                address="perception.yaml: pipelines",
                found=repr(name),
                expected=format_names(read),
                triggered_by=by,
                fix=f"Name {name!r} in the pipeline that reads it, or drop what the skill needs of it.",
                kind="unread",
            )
        yield from iter_sensor_problems(name, sensor, profile, contract, by)


def find_sources(need: str, sensors: Sensors, perception: Perception) -> dict[str, Sensor]:
    """The sensors of an observation, by name: the cameras of its pipeline where it is perceived."""
    if not _is_perceived(need, perception):
        found = find_sensor(sensors, need)
        return {found[0]: found[1]} if found is not None else {}
    read = {
        name
        for pipeline in perception.pipelines.values()
        if PERCEIVED[need] in pipeline.produces
        for name in pipeline.sensors
    }
    return {name: sensor for name, sensor in sensors.cameras.items() if name in read}


def _is_perceived(need: str, perception: Perception) -> bool:
    return perception.sensing is Sensing.PERCEIVED and need in PERCEIVED


def _make_missing(need: str, sensors: Sensors, perception: Perception, by: str) -> Problem:
    if _is_perceived(need, perception):
        fix = f"Name cameras in the pipeline that produces {PERCEIVED[need]!r}, or choose the sensing 'truth'."
        address, known = "perception.yaml: pipelines", sorted(sensors.cameras)
    else:
        fix = f"Let a sensor of sensors.yaml provide {need!r}."
        address = "sensors.yaml: sensors"
        known = sorted({name for sensor in sensors.sensors.values() for name in sensor.provides})
    return make_problem("OBSERVATION_MISMATCH", address, repr(need), format_names(known), by, fix, kind="missing")


def _iter_freshness_problems(cameras: dict[str, Sensor], perception: Perception, by: str) -> Iterator[Problem]:
    """Cameras whose picture is too old before the next one has come, so that it is stale again and again."""
    for name, sensor in cameras.items():
        late_s = sensor.camera.latency_s if sensor.camera is not None else 0.0
        left_s = perception.embedded.max_age_s - late_s
        if left_s <= 0.0 or sensor.rate_hz * left_s < 1.0 - RATE_TOLERANCE:
            yield make_problem(
                "OBSERVATION_MISMATCH",
                address=f"sensors.yaml: sensors.{name}.rate_hz",
                found=sensor.rate_hz,
                expected=f"at least {1.0 / left_s:.3g} Hz"
                if left_s > 0.0
                else f"a latency below {perception.embedded.max_age_s:g} s",
                triggered_by=by,
                fix="Raise it, or embedded.max_age_s of perception.yaml: a picture is too old before the next comes.",
                kind="rate",
            )


def iter_sensor_problems(
    name: str, sensor: Sensor, profile: TargetProfile, contract: RuntimeContract, triggered_by: str
) -> Iterator[Problem]:
    """Modality and rate of one sensor."""
    place = f"sensors.yaml: sensors.{name}"
    for each in sensor.provides:
        usual = MODALITIES.get(each, sensor.modality)
        both = sensor.modality == "rgbd" and usual in ("rgb", "depth")
        if sensor.modality != usual and not both:
            yield make_problem(
                "OBSERVATION_MISMATCH",
                address=f"{place}.modality",
                found=sensor.modality,
                expected=f"{usual}, for {each!r}",
                triggered_by=triggered_by,
                kind="modality",
            )
    if sensor.modality == "simulator_state" and profile.kind == "real_robot":
        fix = "A real robot has no simulator; use a camera."
        found = (f"{place}.modality", sensor.modality, "a sensor of the robot", triggered_by, fix)
        yield make_problem("OBSERVATION_MISMATCH", *found, kind="modality")
    fastest_hz = 1.0 / profile.physics_step_s
    if sensor.modality in _SAMPLED and sensor.rate_hz < contract.sampling_hz * (1.0 - RATE_TOLERANCE):
        fix = "Raise it, or lower sampling_hz: conditions are sampled more often than this sensor measures."
        yield make_problem(
            "OBSERVATION_MISMATCH",
            f"{place}.rate_hz",
            sensor.rate_hz,
            expected=f"at least {contract.sampling_hz:g} Hz",
            triggered_by="runtime_contract.yaml: sampling_hz",
            fix=fix,
            kind="rate",
        )
    elif sensor.rate_hz > fastest_hz * (1.0 + RATE_TOLERANCE):
        fix = "Lower it: nothing changes between two steps of the physics."
        yield make_problem(
            "OBSERVATION_MISMATCH",
            f"{place}.rate_hz",
            sensor.rate_hz,
            f"at most {fastest_hz:g} Hz",
            triggered_by=f"target {profile.target}: physics_step_s",
            fix=fix,
            kind="rate",
        )


def iter_frame_problems(
    skill: SkillRuntime, sensors: Sensors, perception: Perception, cameras: tuple[str, ...]
) -> Iterator[Problem]:
    """Sensors with an unknown frame; the live target knows its cameras, sensors.yaml places additional ones."""
    known = (*BODY_FRAMES, *cameras, *sensors.cameras)
    for need in skill.needs.observations:
        for name, sensor in find_sources(need, sensors, perception).items():
            if sensor.frame not in known:
                yield Problem.unknown(
                    "frame",
                    address=f"sensors.yaml: sensors.{name}.frame",
                    name=sensor.frame,
                    possible=known,
                    by=f"skill {skill.skill}: needs.observations",
                )
