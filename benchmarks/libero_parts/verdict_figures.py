"""Figures of verdicts against hidden labels: errors of both kinds, abstentions apart, intervals clustered by episode.

Cases of one episode share its scene and are no independent trials. Intervals are of a bootstrap that draws episodes
with all their cases; where nothing was wrong, the rule of three over episodes bounds the share instead (Hanley and
Lippman-Hand 1983: at most 3 / n with 95 % confidence).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from phyagentos.bench.report import Ask

ANSWERS = ("success", "failure", "unknown")
DRAWS = 4000  # of the bootstrap
ASKED = {
    "episodes": Ask(300, at_least=True),
    "failures": Ask(1000, at_least=True),
    "successes": Ask(1000, at_least=True),
    "false_successes": Ask(0, at_least=False),
    "false_failure_rate": Ask(0.05, at_least=False),
    "missing": Ask(0, at_least=False),
}


@dataclass(frozen=True, slots=True)
class Case:
    """One moment, judged once.

    Attributes:
        episode: Suite, task and initial state.
        kind: Of the moment.
        success: Whether the benchmark's predicate held at a step of the look, which is how it counts episodes.
        said: What the verdict says: `success`, `failure`, or `unknown`, which abstains.
        why: The criteria with their truth, or the reason.
        at_end: Whether it held at the last of these steps; contacts of things at rest come and go by a micrometre.
    """

    episode: tuple[str, int, int]
    kind: str
    success: bool
    said: str
    why: tuple[str, ...] = ()
    at_end: bool = False

    @property
    def is_wrong(self) -> bool:
        """Whether it says success of a failure, or failure of a success."""
        return self.said == ("failure" if self.success else "success")


@dataclass(frozen=True, slots=True)
class Share:
    """Cases that are so among those that could be, with the interval at 95 %."""

    count: int
    trials: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """NaN without trials."""
        return self.count / self.trials if self.trials else float("nan")

    def __str__(self) -> str:
        """`3/120 = 2.50 % [0.80, 4.90]`, or `-` without trials."""
        if not self.trials:
            return "-"
        return f"{self.count}/{self.trials} = {100 * self.value:.2f} % [{100 * self.low:.2f}, {100 * self.high:.2f}]"


def read_case(record: Mapping[str, Any]) -> Case:
    """From a line of the results; raises KeyError and ValueError."""
    if record["said"] not in ANSWERS:
        raise ValueError(record["said"])
    episode = (str(record["suite"]), int(record["task"]), int(record["state"]))
    kind, success, why = str(record["kind"]), bool(record["success"]), tuple(record.get("why", ()))
    return Case(episode, kind, success, record["said"], why, bool(record.get("at_end", success)))


def read_run(record: Mapping[str, Any]) -> Case:
    """The end of a run of `benchmarks.libero`, from a line of its results."""
    said = {"success": "success", "untranslated": "unknown"}.get(record["verdict"], "failure")
    episode = (str(record["suite"]), int(record["task"]), int(record["state"]))
    success = bool(record["success"])
    return Case(episode, "end of a run", success, said, (str(record["reason"]),), at_end=success)


def share(cases: Sequence[Case], is_so: Callable[[Case], bool], seed: int) -> Share:
    """The share of cases that are so; at 0 or all of them bounded by the rule of three over their episodes."""
    counts: dict[tuple[str, int, int], list[int]] = {}
    for each in cases:
        both = counts.setdefault(each.episode, [0, 0])
        both[0] += is_so(each)
        both[1] += 1
    found, trials = sum(map(is_so, cases)), len(cases)
    bound = min(1.0, 3.0 / max(len(counts), 1))
    if found in {0, trials}:
        return Share(found, trials, 1.0 - bound if found else 0.0, 1.0 if found else bound)
    low, high = bootstrap(np.array(list(counts.values())), np.random.default_rng(seed))
    return Share(found, trials, low, high)


def bootstrap(counts: np.ndarray, rng: np.random.Generator) -> tuple[float, float]:
    """The interval at 95 % of a ratio of sums.

    Args:
        counts: (n_episodes, 2) cases that are so, and cases, of each episode.
        rng: Draws episodes with replacement.
    """
    n = len(counts)
    sums = rng.multinomial(n, np.full(n, 1.0 / n), size=DRAWS) @ counts  # (draws, 2)
    low, high = np.quantile(sums[:, 0] / np.maximum(sums[:, 1], 1), (0.025, 0.975))
    return float(low), float(high)


def balance(cases: Sequence[Case], says_success: Callable[[Case], bool] = lambda each: each.said == "success") -> float:
    """Balanced accuracy: the mean of the shares of successes and failures that are told; NaN without both."""
    told = [[says_success(each) == is_met for each in cases if each.success is is_met] for is_met in (True, False)]
    return float(np.mean([np.mean(each) for each in told])) if all(told) else float("nan")


def compute_figures(cases: Sequence[Case], seed: int) -> dict[str, float]:
    """Those of the closing line. An abstention is neither error, and no success told."""
    met, missed = _split(cases)
    decided = [each for each in met if each.said != "unknown"]
    false_success = share(missed, lambda each: each.is_wrong, seed)
    false_failure = share(decided, lambda each: each.is_wrong, seed)
    return {
        "episodes": len({each.episode for each in cases}),
        "failures": len(missed),
        "successes": len(met),
        "false_successes": false_success.count,
        "false_success_high": false_success.high,
        "false_failures": false_failure.count,
        "false_failure_rate": false_failure.value,
        "false_failure_high": false_failure.high,
        "abstained_of_failures": sum(each.said == "unknown" for each in missed),
        "abstained_of_successes": len(met) - len(decided),
        "false_successes_at_end": sum(each.said == "success" and not each.at_end for each in cases),
        "labels_that_flicker": sum(each.at_end is not each.success for each in cases),
        "balanced_accuracy": balance(cases),
        "balanced_accuracy_decided": balance([each for each in cases if each.said != "unknown"]),
        "balanced_accuracy_always_yes": balance(cases, lambda _: True),
        "balanced_accuracy_always_no": balance(cases, lambda _: False),
    }


def show(console: Console, cases: Sequence[Case], seed: int, most: int = 40) -> None:
    """A row for each kind of moment, each suite, all, and who always says the same; then what was wrong."""
    table = Table(
        "",
        "failures",
        "false successes",
        "unknown",
        "successes",
        "false failures",
        "unknown ",
        "balanced",
        title="Verdicts against LIBERO's predicate, sensing: state; intervals clustered by episode",
    )
    for name, of, is_last in _group(cases):
        table.add_row(name, *_describe(of, seed), end_section=is_last)
    met, missed = _split(cases)
    table.add_row("always yes", str(len(missed)), "100 %", "0", str(len(met)), "0 %", "0", "0.500")
    table.add_row("always no", str(len(missed)), "0 %", "0", str(len(met)), "100 %", "0", "0.500")
    console.print(table)
    for each in [each for each in cases if each.is_wrong][:most]:
        suite, task, state = each.episode
        wrong = "false failure" if each.success else "false success"
        told = "; ".join(why for why in each.why if each.success is False or " true: " not in why)
        console.print(f"{wrong}, {suite}/{task} from {state}, {each.kind}: {told}", highlight=False, soft_wrap=True)


def _group(cases: Sequence[Case]) -> Iterator[tuple[str, Sequence[Case], bool]]:
    for names in ([each.kind for each in cases], [each.episode[0] for each in cases]):
        order = list(dict.fromkeys(names))
        for name in order:
            yield name, [each for each in cases if name in {each.kind, each.episode[0]}], name == order[-1]
    yield "all", cases, True


def _describe(cases: Sequence[Case], seed: int) -> list[str]:
    met, missed = _split(cases)
    decided = [each for each in met if each.said != "unknown"]
    balanced = balance(cases)
    return [
        str(len(missed)),
        str(share(missed, lambda each: each.is_wrong, seed)),
        str(sum(each.said == "unknown" for each in missed)),
        str(len(met)),
        str(share(decided, lambda each: each.is_wrong, seed)),
        str(len(met) - len(decided)),
        f"{balanced:.3f}" if np.isfinite(balanced) else "-",
    ]


def _split(cases: Sequence[Case]) -> tuple[list[Case], list[Case]]:
    """Those that are met, and those that are not."""
    return [each for each in cases if each.success], [each for each in cases if not each.success]
