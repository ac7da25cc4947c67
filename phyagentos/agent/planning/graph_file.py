"""A plan as a goal graph: the YAML file that an author would have written, with a reason above each node."""

from typing import Any

import yaml

from phyagentos.agent.planning.planned import PlannedGoal
from phyagentos.protocol.documents.markdown import escape_label

_HEAD = "# Planned by effects from the world as it stood; `paos plan` shows the reasons again.\n"


def write_graph(planned: PlannedGoal) -> str:
    """The text of the goal graph; a goal that is met already has none.

    Raises:
        ValueError: The plan has no steps.
    """
    if not planned.steps:
        raise ValueError("a goal that is met already needs no goal graph")
    wanted = planned.wanted
    head: dict[str, Any] = {
        "goal": wanted.goal,
        "objective": wanted.objective,
        "scene": wanted.scene,
        "targets": dict(planned.roles),
    }
    head |= {"constraints": list(wanted.constraints)} if wanted.constraints else {}
    head |= {"defaults": {"timeout_s": 60, "max_replans": 2}}
    lines = [_HEAD, _dump(head), "sessions:\n"]
    for step in planned.steps:
        lines += [f"  # {reason}\n" for reason in step.reasons]
        node: dict[str, Any] = {"after": list(step.after)} if step.after else {}
        node |= {"skill": step.skill, "target": step.target, "with": dict(step.parameters)}
        node |= {"accept": list(step.accept)} if step.accept else {}
        lines += [f"  {line}\n" for line in _dump({step.name: node}).splitlines()]
    return "".join([*lines, _dump({"accept": list(wanted.accept)})])


def render_mermaid(planned: PlannedGoal) -> str:
    """The partial order as a Mermaid flowchart."""
    ids = {step.name: f"n{index}" for index, step in enumerate(planned.steps)}
    lines = ["flowchart LR"]
    for step in planned.steps:
        label = f"<b>{escape_label(step.name)}</b><br/>{escape_label(f'{step.skill} on {step.target}')}"
        lines.append(f'    {ids[step.name]}["{label}"]')
    lines += [f"    {ids[before]} --> {ids[step.name]}" for step in planned.steps for before in step.after]
    return "\n".join(lines) + "\n"


def _dump(data: dict[str, Any]) -> str:
    return yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=1000)
