"""Statecharts as tables: the rows are the code, the documentation and the test model.

`transitions` fires every event on a model of its own, so one machine serves every session and thread. Rejected: a
dictionary compiled from the table, which leaves conditions to its callers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol


class Model(Protocol):
    """What an event is fired on; the machine changes its state."""

    state: str


Condition = Callable[[Any], bool]  # of the `EventData` of transitions


@dataclass(frozen=True, slots=True)
class Row:
    """One row of a table: `trigger` leads from each of `sources` to `dest`, by these sides, under a named condition."""

    trigger: str
    sources: tuple[str, ...]
    dest: str
    by: tuple[str, ...] = ()
    when: str = ""


class Statechart:
    """A table, compiled by `transitions` without auto transitions.

    Args:
        states: In the order of the documentation.
        rows: The table.
        find_condition: Condition of a row, None where there is none.
    """

    def __init__(
        self, states: type[StrEnum], rows: Sequence[Row], find_condition: Callable[[Row], Condition | None]
    ) -> None:
        # late: a process that only reads records needs no machine
        from transitions import EventData, Machine, MachineError, Transition

        class Move(Transition):
            """The condition, then the new state: no chart here has callbacks, which are most of an event's cost."""

            def execute(self, event_data: EventData) -> bool:
                conditions: Any = self.conditions
                model: Any = event_data.model
                for condition in conditions:
                    if not condition.func(event_data):
                        return False
                model.state = self.dest
                return True

        class Chart(Machine):
            transition_cls = Move

        self._refusal = MachineError
        self.machine = Chart(
            model=None,
            states=[state.value for state in states],
            transitions=[
                {
                    "trigger": row.trigger,
                    "source": [str(source) for source in row.sources],
                    "dest": str(row.dest),
                    "conditions": find_condition(row),
                }
                for row in rows
            ],
            initial=next(iter(states)).value,
            auto_transitions=False,
            send_event=True,
            queued=False,
        )

    def fire(self, model: Model, trigger: str) -> bool:
        """Fire one event; False, and the model unchanged, when no row of the table allows it."""
        event = self.machine.events.get(trigger)
        try:
            return event is not None and bool(event.trigger(model))
        except self._refusal:
            return False


def render_rows(rows: Sequence[Row]) -> list[str]:
    """The arrows of a Mermaid statechart; each carries its trigger, and who may fire it or when."""
    arrows = []
    for row in rows:
        label = f" ({', '.join(row.by)})" if row.by else ""
        label += f" [{row.when}]" if row.when else ""
        arrows += [f"    {source} --> {row.dest}: {row.trigger}{label}" for source in row.sources]
    return arrows
