"""Other readings of a chunk that was refused: the lines of a contract with which it would be carried out.

A chunk in degrees, with another gripper's convention or with a batch axis is sound to its model. Each reading is tried
by the bridges that it would have.
"""

from collections.abc import Callable, Iterator
from itertools import chain as join
from itertools import combinations

import numpy as np

from phyagentos.errors import Problem
from phyagentos.protocol.capabilities.action_spaces import UNIT_ROTATIONS, ActionSpace, GripperRange
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.runtime.actions.bridges.bridge import Array
from phyagentos.runtime.actions.bridges.chain import BridgeChain, Bridged
from phyagentos.runtime.actions.violations import Violation, ViolationCode

GREATEST = (1.0, 100.0, 255.0, 1000.0)  # of a gripper's column, in the forms that are in use
STRANGE = 1.5  # of a gripper's range, from its middle; what is nearer is left to the guard
Compile = Callable[[ActionSpace], BridgeChain | tuple[Problem, ...]]


def read_rows(chain: BridgeChain, rows: Array, before: Array, velocity: Array) -> Bridged | Violation:
    """As `BridgeChain.apply`; an opening far beyond closed and open is another gripper's convention, and refused."""
    bridged, gripper = chain.apply(rows, before[: chain.target.width], velocity), chain.source.gripper
    if isinstance(bridged, Violation) or gripper is None or chain.source.clamp:
        return bridged
    column = rows.reshape(-1, rows.shape[-1])[:, chain.source.arm_width]
    beyond = np.abs((column - gripper.closed) / (gripper.open - gripper.closed) - 0.5)
    if beyond.max() <= STRANGE:
        return bridged
    row, limit = int(beyond.argmax()), max(gripper.closed, gripper.open)
    return Violation(
        ViolationCode.GRIPPER_WIDTH,
        "gripper",
        float(column[row]),
        limit,
        "",
        row,
        words=f"found {column[row]:g}; closed is {gripper.closed:g}, open {gripper.open:g}",
    )


def suggest_lines(space: ActionSpace, compile_from: Compile, rows: Array, before: Array, velocity: Array) -> str:
    """A sentence with the lines of `action_space` that let these rows pass; empty where none are known."""
    form = _find_form(space, rows)
    for few in join(*(combinations(list(_iter_changes(space, rows)), count) for count in (0, 1, 2))):
        changes = {key: value for each in (form, *few) for key, value in each.items()}
        compiled = compile_from(space.model_copy(update=changes)) if changes else ()
        if isinstance(compiled, BridgeChain) and isinstance(read_rows(compiled, rows, before, velocity), Bridged):
            lines = ", ".join(f"`{key}: {_write(value)}`" for key, value in changes.items())
            also = ", or closed and open exchanged" if "gripper" in changes else ""
            return f"It would be carried out with {lines} in action_space of SKILL.md{also}, if that is meant."
    return ""


def _find_form(space: ActionSpace, rows: Array) -> Fields:
    """What an axis, columns or rows too many would be."""
    form: Fields = {"batch": True} if rows.ndim == 3 and len(rows) == 1 else {}
    rows = rows[0] if form else rows
    if rows.ndim == 2 and rows.shape[1] > space.width + space.padding:
        form["padding"] = rows.shape[1] - space.width
    if rows.ndim == 2 and len(rows) > space.chunk_length:
        form["chunk_length"] = len(rows)
    return form


def _iter_changes(space: ActionSpace, rows: Array) -> Iterator[Fields]:
    """Units, forms and conventions that are easily mistaken."""
    if space.representation == "joint_position" or space.rotation in UNIT_ROTATIONS:
        yield {"angle_unit": "deg" if space.angle_unit == "rad" else "rad"}
    yield {"delta": not space.delta}
    if space.gripper is not None and rows.shape[-1] >= space.width and rows.size:
        column = rows[..., space.width - 1]
        greatest = next((each for each in GREATEST if each >= abs(column).max()), GREATEST[-1])
        yield {"gripper": GripperRange(closed=-greatest if column.min() < 0.0 else 0.0, open=greatest)}


def _write(value: object) -> str:
    if isinstance(value, GripperRange):
        return f"{{closed: {value.closed:g}, open: {value.open:g}}}"
    return str(value).lower() if isinstance(value, bool) else str(value)
