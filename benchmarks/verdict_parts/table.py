"""The table of verdicts: false successes and false failures with their intervals, by class, skill and sensing."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from benchmarks import runner
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


def show(outcomes: Sequence[Outcome], levels: Sequence[str]) -> None:
    """False successes by class, false failures by skill, totals, and what was wrong."""
    missed, met = ([each for each in outcomes if each.met is is_met] for is_met in (False, True))
    classes = {kind: [e for e in missed if e.kind == kind] for kind in _order(e.kind for e in missed)}
    skills = {skill: [e for e in met if e.skill == skill] for skill in _order(e.skill for e in met)}
    skills["unplanned success"] = [each for each in met if each.kind == "unplanned success of a failed primitive"]
    for title, groups, rate in (
        ("false successes: said success, and it was not met", classes | {"all": missed}, rate_false_success),
        ("false failures: it was met, and success was not said", skills | {"all": met}, rate_false_failure),
    ):
        rows = (_list_cells(name, group, levels, rate) for name, group in groups.items())
        runner.show(title, ("class or skill", *levels, "controller returned ok"), rows)
    for each in [each for each in outcomes if each.accepted != each.met][:30]:
        said = "false success" if each.accepted else "false failure"
        told = "; ".join(f"{c.text} {c.truth}: {c.because}" for c in each.attempt.criteria if c.truth is not Truth.TRUE)
        print(f"{said}, {each.sensing}, {each.skill}, {each.kind}: {told or each.attempt.reason}")


def _list_cells(name: str, group: Sequence[Outcome], levels: Sequence[str], rate: Callable[..., Rate]) -> list[object]:
    by_level = [[each for each in group if each.sensing == level] for level in levels]
    return [name, *map(rate, by_level), rate(by_level[0], naive=True)]


def _order(names: Iterable[str]) -> list[str]:
    return [name for name, _ in Counter(names).most_common()]
