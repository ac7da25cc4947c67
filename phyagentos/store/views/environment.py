"""ENVIRONMENT.md: the world as last observed, as tables for people and one block of data for programs."""

import msgspec
from msgspec import UNSET

from phyagentos.geometry import compute_tilt
from phyagentos.protocol.documents.body_codec import render_flow
from phyagentos.protocol.documents.document import Front
from phyagentos.protocol.documents.markdown import flatten, render_front, render_table
from phyagentos.protocol.predicates.relations import compute_relations, find_places
from phyagentos.protocol.world.environment import (
    ENVIRONMENT,
    Change,
    Entity,
    Environment,
    Relation,
    Snapshot,
    Status,
    TargetState,
)

_HEAD = """# The world as last observed

What the runtime saw after a session had ended. Poses are in the frame `world`: z up, metres, quaternions w x y z.

- **Written by** the worker of the target whose session ended last, from its own observation; of sessions that end
  within a fifth of a second the latest.
- **An edit is lost** with the next observation. The agent reads this file only where preflight refused a session before
  any was executed. The snapshots that verdicts rest on are in the evidence bundles (`environment_before.json`,
  `environment_after.json`).
- **Old facts are not facts.** Each thing carries the time it was observed at; a predicate over a stale or missing fact
  is *unknown*, which is never success.

"""
CHANGES_SHOWN = 12  # in the line for people; the block has all
_NOTHING = "Nothing has been observed yet.\n"
_COLUMNS = ("name", "kind", "where", "x y z [m]", "tilt [rad]", "speed [m/s]", "seen", "observed at [s]", "confidence")


def render_environment(environment: Environment | None) -> str:
    """ENVIRONMENT.md; without an argument as it is before anything was observed."""
    front = render_front(Front(phy=ENVIRONMENT.phy))
    if environment is None:
        return f"{front}{_HEAD}{_NOTHING}"
    places = {name: find_places(each, environment) for name, each in environment.entities.items()}
    facts = (
        f"- **Scene:** {flatten(environment.scene)}, episode {flatten(environment.episode)}\n"
        f"- **Time:** {environment.time_s:.3f} s of the target's own clock, snapshot {environment.revision}\n"
        f"- **Sensing:** {flatten(environment.sensing)}\n"
        f"- **Since the snapshot before:** {_format_changes(environment.changes)}\n\n"
    )
    objects = [(name, *_describe(entity, places[name])) for name, entity in environment.entities.items()]
    text = f"{front}{_HEAD}{facts}## Things\n\n" + render_table(_COLUMNS, objects)
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
    reports = [(name, *_list_supplies(t)) for name, t in environment.targets.items() if t.inventory is not UNSET]
    if reports:
        columns = ("name", "at x y [m], heading [rad]", "carries", "vitals", "in reach", "daylight")
        text += "\n## Supplies\n\n" + render_table(columns, reports)
    cameras = [
        (name, health.status, f"{health.time_s:.3f}", health.detail or "nothing")
        for name, health in environment.sensors.items()
    ]
    if cameras:
        text += "\n## Cameras\n\n" + render_table(("name", "status", "latest frame [s]", "to say"), cameras)
    snapshot = _render_snapshot(environment, compute_relations(environment, places))
    return f"{text}\n## Snapshot\n\n```yaml\n{snapshot}```\n"


def _list_supplies(target: TargetState) -> tuple[str, ...]:
    inventory, vitals = target.inventory or {}, target.vitals or {}
    return (
        _format_numbers(target.base) if target.base is not None else "",
        ", ".join(f"{amount} {flatten(item)}" for item, amount in inventory.items()) or "nothing",
        ", ".join(f"{flatten(name)} {level:g}" for name, level in vitals.items()),
        ", ".join(map(flatten, target.nearby or ())) or "nothing",
        "" if target.daylight is UNSET else f"{target.daylight:.2f}",
    )


def _format_changes(changes: tuple[Change, ...]) -> str:
    shown = [
        f"{flatten(each.entity)} {flatten(each.what)}" + (f" by {each.by_m:.3f} m" if each.what == "moved" else "")
        for each in changes[:CHANGES_SHOWN]
    ]
    more = len(changes) - len(shown)
    return (", ".join(shown) or "nothing") + (f", and {more} more" if more > 0 else "")


def _describe(entity: Entity, places: list[Relation]) -> tuple[str, ...]:
    return (
        f"{entity.color} {entity.kind}".strip(),
        _locate(entity, places),
        _format_numbers(entity.pose.position_m),
        f"{compute_tilt(entity.pose):.3f}",
        f"{entity.speed_m_s:.3f}",
        entity.status.value if entity.visible or entity.status is not Status.SEEN else "no",
        f"{entity.observed_at_s:.3f}",
        f"{entity.confidence:.2f}",
    )


def _locate(entity: Entity, places: list[Relation]) -> str:
    if entity.held_by:
        return f"held by {entity.held_by}"
    if not entity.movable:
        return "fixed"
    return ", ".join(f"{place.name} {place.arguments[1]}" for place in places) or "unknown"


def _format_numbers(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.3f}" for value in values)


def _render_snapshot(environment: Environment, relations: tuple[Relation, ...]) -> str:
    """YAML with one object a line, so that two snapshots can be compared line by line."""
    snapshot = Snapshot(**(msgspec.structs.asdict(environment) | {"relations": relations}))
    lines = []
    for name, value in msgspec.to_builtins(snapshot).items():
        if name == "relations" and value:
            lines += [f"{name}:", *(f"  - {render_flow(each)}" for each in value)]
        elif isinstance(value, dict) and value:
            lines += [f"{name}:", *(f"  {render_flow(key)}: {render_flow(each)}" for key, each in value.items())]
        else:
            lines.append(f"{name}: {render_flow(value)}")
    return "\n".join(lines) + "\n"
