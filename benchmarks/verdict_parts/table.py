"""The table of verdicts: false successes and false failures with their intervals, by class, skill and sensing."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table

from phyagentos.bench.report import Rate
from phyagentos.protocol.sessions.verdicts import Attempt, Verdict
from phyagentos.protocol.world.truth import Truth


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """One case, judged once.

    Attributes:
        sensing: What was believed.
        skill: Whose session it was.
        kind: Its class.
        met: Whether the objective is met, as the other eye says.
        controller_ok: What the controller reported.
        attempt: What the verifier said.
    """

    sensing: str
    skill: str
    kind: str
    met: bool
    controller_ok: bool
    attempt: Attempt

    @property
    def accepted(self) -> bool:
        """Whether the verifier says success."""
        return self.attempt.verdict is Verdict.SUCCESS

    @property
    def is_unknown(self) -> bool:
        """Whether it says that it cannot tell."""
        truths = [criterion.truth for criterion in self.attempt.criteria]
        return Truth.FALSE not in truths and Truth.UNKNOWN in truths


def rate_false_success(outcomes: Sequence[Outcome], *, naive: bool = False) -> Rate:
    """Successes said of objectives that were not met."""
    missed = [each for each in outcomes if not each.met]
    return Rate(sum(each.controller_ok if naive else each.accepted for each in missed), len(missed))


def rate_false_failure(outcomes: Sequence[Outcome], *, naive: bool = False) -> Rate:
    """No success said of objectives that were met, unknown included."""
    met = [each for each in outcomes if each.met]
    return Rate(sum(not (each.controller_ok if naive else each.accepted) for each in met), len(met))


def build_figures(outcomes: Sequence[Outcome], levels: Sequence[str]) -> dict[str, float]:
    """The figures of the closing line."""
    figures: dict[str, float] = {}
    for level in levels:
        seen = [each for each in outcomes if each.sensing == level]
        met = [each for each in seen if each.met]
        figures[f"false_success_{level}"] = rate_false_success(seen).value
        figures[f"false_failure_{level}"] = rate_false_failure(seen).value
        figures[f"unknown_of_successes_{level}"] = Rate(sum(each.is_unknown for each in met), len(met)).value
    first = [each for each in outcomes if each.sensing == levels[0]]
    figures["false_success_controller"] = rate_false_success(first, naive=True).value
    figures["false_failure_controller"] = rate_false_failure(first, naive=True).value
    figures["failures"] = float(sum(not each.met for each in first))
    figures["successes"] = float(sum(each.met for each in first))
    return figures


def show(console: Console, outcomes: Sequence[Outcome], levels: Sequence[str]) -> None:
    """False successes by class, false failures by skill, totals."""
    first = [each for each in outcomes if each.sensing == levels[0]]
    wrong = _make_table("false successes: said success, and it was not met", "class", levels)
    for kind in _order(each.kind for each in first if not each.met):
        _add_row(wrong, kind, outcomes, levels, kind=kind, successes=True)
    _add_row(wrong, "all", outcomes, levels, successes=True)
    console.print(wrong)
    missed = _make_table("false failures: it was met, and success was not said", "skill", levels)
    for skill in _order(each.skill for each in first if each.met):
        _add_row(missed, skill, outcomes, levels, skill=skill, successes=False)
    _add_row(
        missed, "unplanned success", outcomes, levels, kind="unplanned success of a failed primitive", successes=False
    )
    _add_row(missed, "all", outcomes, levels, successes=False)
    unknown = ["of these, unknown"]
    for level in levels:
        met = [each for each in outcomes if each.met and each.sensing == level]
        unknown.append(str(Rate(sum(each.is_unknown for each in met), len(met))))
    missed.add_row(*unknown, "")
    console.print(missed)
    for each in [each for each in outcomes if each.accepted != each.met][:30]:
        said = "false success" if each.accepted else "false failure"
        told = "; ".join(f"{c.text} {c.truth}: {c.because}" for c in each.attempt.criteria if c.truth is not Truth.TRUE)
        console.print(f"{said}, {each.sensing}, {each.skill}, {each.kind}: {told or each.attempt.reason}", style="dim")


def _make_table(title: str, first: str, levels: Sequence[str]) -> Table:
    return Table(first, *levels, "controller returned ok", title=title)


def _add_row(
    table: Table,
    name: str,
    outcomes: Sequence[Outcome],
    levels: Sequence[str],
    *,
    successes: bool,
    kind: str | None = None,
    skill: str | None = None,
) -> None:
    chosen = [each for each in outcomes if kind in {None, each.kind} and skill in {None, each.skill}]
    rate = rate_false_success if successes else rate_false_failure
    cells = [str(rate([each for each in chosen if each.sensing == level])) for level in levels]
    naive = str(rate([each for each in chosen if each.sensing == levels[0]], naive=True))
    table.add_row(name, *cells, naive)


def _order(names: object) -> list[str]:
    return [name for name, _ in Counter(names).most_common()]  # type: ignore[arg-type,call-overload]
