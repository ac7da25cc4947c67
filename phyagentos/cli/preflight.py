"""`paos preflight`: what every session would be granted, or every reason why it would be refused."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated

import typer

from phyagentos.assembly.project import admit_python
from phyagentos.cli.arguments import Overrides, TrustPython
from phyagentos.cli.outcome import ExitCode, print_note
from phyagentos.cli.reply import Reply
from phyagentos.errors import Problem
from phyagentos.operations import preflight as preflights
from phyagentos.operations.preflight import Preflight, SessionCheck
from phyagentos.protocol.sessions.lookahead import LookaheadResult, Outcomes

_WHOSE = "Whose settings count; needed for a session."


def preflight(
    subject: Annotated[str, typer.Argument(metavar="GRAPH|SESSION", help="A goal graph, or a session of a workspace.")],
    workspace: Annotated[Path | None, typer.Option("--workspace", "-w", help=_WHOSE)] = None,
    seed: Annotated[int, typer.Option(help="Of the scene.", min=0, max=2**63 - 1)] = 0,
    set_: Overrides = None,
    trust_python: TrustPython = False,
) -> Reply[Preflight]:
    """Check every session against its live target, without moving anything: plan and tools, or every problem."""
    if workspace is not None:
        admit_python(workspace, is_trusted=trust_python, announce=print_note)
    found = preflights.check(subject, workspace, seed=seed, overrides=set_ or ())
    text = "\n".join(line for report in found.sessions for line in _render(report))
    notes = [each.forecast_problem for each in found.sessions if each.forecast_problem]
    if not found.refused:
        return Reply(found, text, notes)
    refused = f"{len(found.refused)} of {len(found.sessions)} would be rejected: {', '.join(found.refused)}"
    return Reply(found, text, [*notes, refused], ExitCode.REJECTED)


def _render(report: SessionCheck) -> Iterator[str]:
    """One session for people."""
    yield f"{report.session}: {'would be REJECTED' if report.problems else 'fits'}"
    for word, problems in (("problem", report.problems), ("later  ", report.decided_later)):
        yield from (line for each in problems for line in _render_problem(word, each, report.session))
    yield from (f"  awaits   {name} from {value}" for name, value in report.awaits.items())
    if report.plan is not None:
        yield from (f"  {line}" for line in str(report.plan).splitlines())
        yield from (f"  tool     {line}" for line in str(report.tools).splitlines())
    for trial in report.trials:
        reason = f": {trial.code} {trial.message}" if trial.outcome != "possible" else ""
        yield f"  dry run  {trial.motion}: {trial.outcome}{reason} ({trial.ms:.0f} ms)"
    if report.forecast is not None:
        yield from (f"  {line}" for line in render_forecast(report.forecast))
    yield f"  cost     {report.ms:.0f} ms"


def _render_problem(word: str, each: Problem, session: str) -> Iterator[str]:
    yield f"  {word}  {each.label} at {each.address.removeprefix(f'{session}: ')}"
    yield f"           found {each.found}; expected {each.expected}"
    for label, value in (("required by", each.triggered_by), ("fix:", each.hint)):
        if value:
            yield f"           {label} {value}"


def render_forecast(forecast: LookaheadResult) -> Iterator[str]:
    """A forecast for people, as lines."""
    yield from (f"not asked: {name}, {record}" for name, record in forecast.withheld.items())
    if not forecast.samples:
        return
    counted = f"{forecast.succeeded:.4g} of {forecast.samples} {forecast.cases}, {forecast.threshold:g} asked"
    cost = f"{'; refused' if forecast.is_low else ''} ({forecast.cost_ms:.0f} ms)"
    yield f"foreseen {_show_chance(forecast)} success: {counted}{cost}"
    if forecast.causes:
        yield f"         likely to fail of {forecast.likely_cause}: {_list_causes(forecast.causes)}"
    for other in forecast.alternatives:
        failed = f", {_list_causes(other.causes)}" if other.causes else ""
        changed = other.strategy or "with nothing changed"
        yield f"         {changed}: {other.succeeded:.4g} of {other.samples}{failed}"
    for each in forecast.others:
        yield f"         beside it {_show_chance(each)} by {each.forecaster} ({each.cost_ms:.0f} ms)"


def _show_chance(found: Outcomes) -> str:
    low, high = found.interval
    return f"{100 * found.share:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


def _list_causes(causes: Mapping[str, float]) -> str:
    return ", ".join(f"{cause} ({count:.4g})" for cause, count in sorted(causes.items(), key=lambda each: -each[1]))
