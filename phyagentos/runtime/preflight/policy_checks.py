"""A policy against the sensors, the target and the clock; and against the descriptor of its running server.

Its action space is checked by compiling the bridges.
"""

from collections.abc import Callable, Iterator
from urllib.parse import urlsplit

from phyagentos.errors import ExecutionError, Problem, format_names
from phyagentos.protocol.capabilities.policy_descriptors import (
    CLIENT_SIDE,
    MODEL_SCHEME,
    POLICY_PROTOCOL,
    POLICY_WIRES,
    WORLD,
    PolicyDescriptor,
    Stream,
)
from phyagentos.protocol.capabilities.skill_runtimes import SkillRuntime
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.settings.sensors import Length, Sensor, Sensors, Signal, find_source
from phyagentos.runtime.preflight.findings import make_problem
from phyagentos.runtime.preflight.sensing import RATE_TOLERANCE

TIME_TOLERANCE_S = 1e-9
POSE_WIDTH = 7  # position and quaternion
# endpoint -> descriptor of its server, None where it says nothing of itself; raises ExecutionError without a server
AskPolicy = Callable[[str], PolicyDescriptor | None]


def iter_policy_problems(
    skill: SkillRuntime, profile: TargetProfile, sensors: Sensors, late_max_s: float
) -> Iterator[Problem]:
    """Every problem of a policy's declaration; pictures may come `late_max_s` [s] after one period of their stream."""
    policy, by = skill.policy, f"skill {skill.skill}"
    if policy is None or skill.action_space is None:
        for name, declared in (("policy", policy), ("action_space", skill.action_space)):
            if declared is None:
                fix = f"Add {name!r} to SKILL.md: a policy is checked by what it declares."
                yield make_problem("POLICY_MISMATCH", f"skill.{name}", "nothing", name, by, fix)
        return
    by = f"policy {policy.policy}"
    if not _is_endpoint(policy.endpoint):
        expected = f"SCHEME://HOST:PORT with one of {format_names(POLICY_WIRES.names())}"
        yield make_problem("INVALID_VALUE", "skill.policy.endpoint", repr(policy.endpoint), expected, by)
    if policy.protocol != POLICY_PROTOCOL:
        found = f"version {policy.protocol}"
        yield make_problem("VERSION_MISMATCH", "skill.policy.protocol", found, f"version {POLICY_PROTOCOL}", by)
    for name, stream in policy.observations.items():
        if name == WORLD:
            yield from _iter_world_problems(stream, skill, by)
            continue
        yield from _iter_stream_problems(name, stream, profile, sensors, by)
        yield from _iter_lateness_problems(name, stream, sensors, late_max_s, by)
    chunk_s = skill.action_space.chunk_length / skill.action_space.rate_hz
    horizon, longest = policy.execution.horizon or 1, skill.action_space.chunk_length
    if horizon > longest:
        address, fix = "skill.policy.execution.horizon", "The next chunk must come before this one ends."
        yield make_problem("ACTION_SPACE_MISMATCH", address, f"{horizon} rows", f"1 to {longest} rows", by, fix)
    if policy.inference_s > chunk_s:
        address, found = "skill.policy.inference_s", f"{policy.inference_s:g} s"
        expected, by = f"at most {chunk_s:g} s, which one chunk lasts", f"{by}: chunk_length / rate_hz"
        fix = "Longer chunks, or a faster server: the robot would wait in the middle of a motion."
        yield make_problem("POLICY_MISMATCH", address, found, expected, by, fix)


def iter_served_problems(skill: SkillRuntime, ask: AskPolicy) -> Iterator[Problem]:
    """Where the server's own description differs from the declared one."""
    policy = skill.policy
    if policy is None:
        return
    by = f"policy {policy.policy}"
    try:
        served = ask(policy.endpoint)
    except ExecutionError as error:
        expected, fix = f"a policy server at {policy.endpoint}", "Start the server, or mend the endpoint."
        yield make_problem("POLICY_UNREACHABLE", "skill.policy.endpoint", str(error), expected, by, fix)
        return
    for name in PolicyDescriptor.model_fields if served is not None else ():
        declared, found = getattr(policy, name), getattr(served, name)
        if name not in CLIENT_SIDE and declared != found:
            fix = "The server at this endpoint is not the one that SKILL.md describes."
            yield make_problem("POLICY_MISMATCH", f"skill.policy.{name}", str(found), str(declared), by, fix)


def _is_endpoint(text: str) -> bool:
    scheme, _, rest = text.partition(":")
    if scheme not in POLICY_WIRES.names():
        return False
    if scheme == MODEL_SCHEME or scheme not in POLICY_WIRES.shipped:
        return bool(rest)
    try:
        parts = urlsplit(text)
        host, has_port = parts.hostname or "", parts.port is not None or parts.scheme in {"http", "https"}
        host.encode("idna")
    except ValueError:  # half a bracket, a port that is no number, a part of a host's name that is empty or too long
        return False
    return bool(host) and has_port


def _iter_stream_problems(
    name: str, stream: Stream, profile: TargetProfile, sensors: Sensors, by: str
) -> Iterator[Problem]:
    address = f"skill.policy.observations.{name}"
    if name not in profile.observations:
        yield Problem.unknown("observation", address, name, profile.observations, by=by)
        return
    found = find_source(sensors, name, stream.frame)
    if found is None:
        known = sorted({each for sensor in sensors.sensors.values() for each in sensor.provides})
        fix = f"Let a sensor of sensors.yaml provide {name!r}."
        yield make_problem("OBSERVATION_MISMATCH", address, repr(name), format_names(known), by, fix, kind="missing")
        return
    sensor = found[1]
    signal = sensor.signals.get(name) or _describe_picture(stream, sensor)
    if signal is None:
        fix = f"Declare shape, dtype and unit of {name!r} in sensors.yaml, under sensors.{found[0]}.signals."
        yield make_problem("OBSERVATION_MISMATCH", address, "no form in sensors.yaml", "one", by, fix, kind="shape")
    else:
        yield from _iter_form_problems(address, stream, signal, len(profile.arm.joints), by)
    yield from _iter_source_problems(address, stream, sensor, by)


def _iter_world_problems(stream: Stream, skill: SkillRuntime, by: str) -> Iterator[Problem]:
    address = f"skill.policy.observations.{WORLD}"
    objects = [name for name, parameter in skill.parameters.items() if parameter.type in {"entity", "place"}]
    for name in stream.entities or ("",):
        if name not in objects:
            yield Problem.unknown("observation", f"{address}.entities", name, objects, by=by)
    yield from _iter_form_problems(address, stream, Signal(shape=(len(stream.entities), POSE_WIDTH)), 0, by)


def _iter_lateness_problems(
    name: str, stream: Stream, sensors: Sensors, late_max_s: float, by: str
) -> Iterator[Problem]:
    """A camera whose pictures are too old before the next one comes."""
    found = find_source(sensors, name, stream.frame)
    if found is None or found[1].camera is None:
        return
    sensor, latency_s = found[1], found[1].camera.latency_s
    most_s = late_max_s + 1.0 / stream.rate_hz - 1.0 / sensor.rate_hz
    if latency_s > most_s + TIME_TOLERANCE_S:
        yield make_problem(
            "OBSERVATION_MISMATCH",
            address=f"sensors.yaml: sensors.{found[0]}.camera.latency_s",
            found=f"{latency_s:g} s",
            expected=f"at most {max(most_s, 0.0):.3g} s",
            triggered_by=f"{by}: observations.{name}",
            fix="A picture is older than embedded.max_age_s of perception.yaml and one period of the stream.",
            kind="rate",
        )


def _iter_form_problems(address: str, stream: Stream, signal: Signal, n_joints: int, by: str) -> Iterator[Problem]:
    wanted, given = _resolve(stream.shape, n_joints), _resolve(signal.shape, n_joints)
    for name, found, expected in (
        ("shape", str(list(wanted)), str(list(given))),
        ("dtype", stream.dtype, signal.dtype),
        ("unit", stream.unit or "none", signal.unit or "none"),
    ):
        if found != expected:
            yield make_problem("OBSERVATION_MISMATCH", f"{address}.{name}", found, expected, by, kind=name)


def _iter_source_problems(address: str, stream: Stream, sensor: Sensor, by: str) -> Iterator[Problem]:
    both = sensor.modality == "rgbd" and stream.modality in ("rgb", "depth")
    if stream.modality != sensor.modality and not both:
        yield make_problem(
            "OBSERVATION_MISMATCH", f"{address}.modality", stream.modality, sensor.modality, by, kind="modality"
        )
    if stream.frame != sensor.frame:
        yield make_problem("OBSERVATION_MISMATCH", f"{address}.frame", stream.frame, sensor.frame, by, kind="frame")
    if stream.rate_hz > sensor.rate_hz * (1.0 + RATE_TOLERANCE):
        yield make_problem(
            "OBSERVATION_MISMATCH",
            f"{address}.rate_hz",
            stream.rate_hz,
            expected=f"at most {sensor.rate_hz:g} Hz",
            triggered_by=by,
            kind="rate",
        )


def _describe_picture(stream: Stream, sensor: Sensor) -> Signal | None:
    """The form of a camera's picture follows from the camera."""
    if sensor.camera is None:
        return None
    height, width = sensor.camera.height, sensor.camera.width
    if stream.modality == "depth":
        return Signal(shape=(height, width), dtype="float32", unit="m")
    return Signal(shape=(height, width, 3), dtype="uint8")


def _resolve(shape: tuple[Length, ...], n_joints: int) -> tuple[int, ...]:
    return tuple(n_joints if each == "n_joints" else int(each) for each in shape)
