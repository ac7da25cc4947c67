"""ENVIRONMENT.md: the world as last observed, as tables for people and one block of data for programs.

Upstream: the worker of the target. Downstream: predicates, compiler, people.
"""

import re
from pathlib import Path

import msgspec

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.environment import Entity, Environment, Interior
from phyagentos.protocol.markdown import render_table
from phyagentos.protocol.predicates.geometry import compute_center, compute_tilt, to_child

_DATA = re.compile(r"^```json\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_HEAD = """# The world as last observed

Poses are in the frame `world`: z up, metres, quaternions w x y z. Every entity carries the time it was observed at; a
predicate over a stale or missing fact is *unknown*, which is never success.

"""
_COLUMNS = ("name", "kind", "where", "x y z [m]", "tilt [rad]", "speed [m/s]", "seen", "observed at [s]", "confidence")


def render_environment(environment: Environment) -> str:
    """ENVIRONMENT.md."""
    facts = (
        f"- **Scene:** {environment.scene}, episode {environment.episode}\n"
        f"- **Time:** {environment.time_s:.3f} s, snapshot {environment.revision}\n"
        f"- **Sensing:** {environment.sensing}\n\n"
    )
    things = [(name, *_describe(entity, environment)) for name, entity in environment.entities.items()]
    text = f"{_HEAD}{facts}## Things\n\n" + render_table(_COLUMNS, things)
    regions = [
        (name, _format_numbers(region.pose.position_m), _format_numbers(region.half_m))
        for name, region in environment.regions.items()
    ]
    if regions:
        text += "\n## Regions\n\n" + render_table(("name", "centre x y z [m]", "half extents [m]"), regions)
    targets = [
        (name, _format_numbers(t.tcp.position_m), f"{t.gripper_width_m:.4f}", ", ".join(t.holding) or "nothing")
        for name, t in environment.targets.items()
    ]
    if targets:
        text += "\n## Targets\n\n" + render_table(("name", "tcp x y z [m]", "gripper [m]", "holds"), targets)
    return f"{text}\n## Data\n\n```json\n{_encode(environment)}```\n"


def read_environment(path: Path) -> Environment:
    """The block of data of ENVIRONMENT.md.

    Raises:
        DefinitionError: `ENVIRONMENT_UNREADABLE` when there is none (nothing was observed yet) or it is damaged.
    """
    try:
        match = _DATA.search(path.read_text(encoding="utf-8"))
        found = "no block of data"
        if match is not None:
            return msgspec.json.decode(match[1].encode(), type=Environment)
    except (OSError, UnicodeDecodeError, msgspec.MsgspecError) as error:
        found = str(error)
    raise DefinitionError(
        Problem(
            code="ENVIRONMENT_UNREADABLE",
            address=str(path),
            found=found,
            expected="a fenced json block with one Environment",
            hint="It is written by the worker of a target with its first observation.",
        )
    )


def _describe(entity: Entity, environment: Environment) -> tuple[str, ...]:
    return (
        f"{entity.color} {entity.kind}".strip(),
        _locate(entity, environment),
        _format_numbers(entity.pose.position_m),
        f"{compute_tilt(entity.pose):.3f}",
        f"{entity.speed_m_s:.3f}",
        "yes" if entity.visible else "no",
        f"{entity.observed_at_s:.3f}",
        f"{entity.confidence:.2f}",
    )


def _locate(entity: Entity, environment: Environment) -> str:
    """Who holds it, else what it is inside of."""
    if entity.held_by:
        return f"held by {entity.held_by}"
    if not entity.movable:
        return "fixed"
    center = compute_center(entity)
    for other in environment.entities.values():
        if other.name != entity.name and other.interior and _is_in(other.interior, to_child(other.pose, center)):
            return f"inside {other.name}"
    return ""


def _is_in(box: Interior, point: tuple[float, float, float]) -> bool:
    return all(abs(p - c) <= h for p, c, h in zip(point, box.center_m, box.half_m, strict=True))


def _format_numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.3f}" for value in values)


def _encode(environment: Environment) -> str:
    """JSON with one thing a line, so that two snapshots can be compared line by line."""
    plain = msgspec.to_builtins(environment)
    groups = []
    for name, value in plain.items():
        if isinstance(value, dict) and value:
            inner = ",\n".join(f"  {_json(key)}: {_json(each)}" for key, each in value.items())
            groups.append(f"{_json(name)}: {{\n{inner}\n}}")
        else:
            groups.append(f"{_json(name)}: {_json(value)}")
    return "{\n" + ",\n".join(groups) + "\n}\n"


def _json(value: object) -> str:
    return msgspec.json.encode(value).decode()
