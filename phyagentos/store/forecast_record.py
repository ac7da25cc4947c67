"""What forecasts were worth in a workspace: each that was made before a session, beside the verdict on that session.

A session that was refused by its forecast has no verdict, so nothing is learned of it.
"""

from collections.abc import Callable, Iterator

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.calibration import Scored, TrackRecord, compute_record
from phyagentos.protocol.sessions.lookahead import read_lookahead
from phyagentos.protocol.sessions.session import Ended, GoalId, SessionStatus
from phyagentos.protocol.sessions.verdicts import CAUSE_UNKNOWN, Verdict
from phyagentos.protocol.settings.runtime_contract import Forecasting, read_runtime_contract
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.history import fold_partition
from phyagentos.store.journal import choose_partition

INTERRUPTED = frozenset({Ended.RUNNER_LOST, Ended.TARGET_LOST, Ended.CANCELLED})  # from outside


def iter_outcomes(workspace: Workspace) -> Iterator[tuple[SessionStatus, str]]:
    """Every session that a forecast could be about, in the order of submission: empty for a success, else the cause.

    Left out is a session without a verdict, one that had nothing to do, and one that was interrupted from outside.
    """
    ledger = fold_partition(workspace.sessions / choose_partition(workspace.sessions))
    for status in ledger.sessions.values():
        decision, execution = status.decision, status.execution
        if decision is None or execution is None or execution.is_idle or execution.ended in INTERRUPTED:
            continue
        found = decision.found or decision.verdict  # in an audit the execution decides, which is not what happened
        if found is not Verdict.UNVERIFIED:
            yield status, "" if found is Verdict.SUCCESS else decision.cause or CAUSE_UNKNOWN


def collect_scored(
    workspace: Workspace, is_counted: Callable[[SessionStatus], bool] = lambda _: True
) -> dict[str, list[Scored]]:
    """Forecaster, with version -> its forecasts and what happened; an unreadable `lookahead.json` is passed over."""
    found: dict[str, list[Scored]] = {}
    for status, outcome in iter_outcomes(workspace):
        if status.contract.lookahead is None or not is_counted(status):
            continue
        try:
            result = read_lookahead(workspace.evidence_of(status.contract.id))
        except ExecutionError:
            continue
        for forecast in result.forecasts if result is not None else ():
            found.setdefault(forecast.forecaster, []).append(Scored(forecast.share, not outcome))
    return found


def find_distrusted(workspace: Workspace, goal: GoalId) -> dict[str, TrackRecord]:
    """Forecasters that are not asked for a goal: on enough other sessions here they did worse than the base rate."""
    least = read_forecasting(workspace).least_cases
    scored = collect_scored(workspace, lambda status: status.contract.goal != goal)
    records = {name: compute_record(each) for name, each in scored.items()}
    return {name: record for name, record in records.items() if record.is_unfit(least)}


def read_forecasting(workspace: Workspace) -> Forecasting:
    """The block `forecasting` of the settings; raises DefinitionError."""
    file = workspace.runtime_contract
    return read_runtime_contract(file).forecasting if file.exists() else Forecasting()
