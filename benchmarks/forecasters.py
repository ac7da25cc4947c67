"""Forecasters side by side on sessions that none of them has seen: rollouts, learned, and the base rate.

    paos bench run forecasts --run runs/forecasts-1
    python -m benchmarks.forecasters runs/forecasts-1 --held-out 20

The learned forecaster is trained on the first seeds of the run by the kit's own code. Both are then asked about the
sessions of the held-out seeds, from their recorded estimates, through the service that a worker asks. The base rate is
the share of successes among the training sessions.
"""

import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Annotated

from typer import Argument, Option

from benchmarks.runner import finish, run
from phyagentos.bench.records import read_records
from phyagentos.bench.report import Threshold
from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.calibration import Scored, compute_record
from phyagentos.protocol.sessions.evidence import encode_json, read_bundle
from phyagentos.protocol.sessions.lookahead import LookaheadRequest
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.seeds import compute_seed
from phyagentos.runtime.lookahead.forecaster import Case, Forecaster, ForecasterSite, open_forecaster
from phyagentos.runtime.lookahead.service import ForecastService
from phyagentos.store.forecast_record import iter_outcomes

ROOT = Path(__file__).resolve().parents[1]
sys.path += [str(ROOT / "kits" / kit) for kit in ("learned_forecaster", "rollouts")]  # where they are not installed

from learned_forecaster.forecaster import open_learned  # noqa: E402
from learned_forecaster.training import train_model  # noqa: E402
from rollout_forecaster.calibration import calibrate, render  # noqa: E402

ARM, TREE = "panda", "pick_and_place"
ASKED = {"skill_of_rollouts": Threshold(0.0, at_least=True), "skill_of_learned": Threshold(0.0, at_least=True)}


def read_cases(workspace: Workspace) -> Iterator[tuple[Case, bool]]:
    """The sessions of an episode as questions, and whether each succeeded."""
    for status, outcome in iter_outcomes(workspace):
        session, execution = status.contract, status.execution
        if session.purpose or execution is None:
            continue
        before = read_bundle(workspace.evidence_of(session.id), session, execution, with_course=False).before
        if before is not None:
            seed = compute_seed(session.scene.seed, "forecast", session.node)
            request = LookaheadRequest(samples=16, threshold=0.8, seed=seed)
            yield Case(session=session, request=request, tree=TREE, environment=before), not outcome


def ask(name: str, forecaster: Forecaster, cases: Sequence[tuple[Case, bool]]) -> tuple[list[Scored], list[float]]:
    """Forecasts beside what happened, and what each cost [ms]; one that is not given counts as one half."""
    service = ForecastService({name: forecaster}.__getitem__, SystemClock())
    scored, costs = [], []
    for case, succeeded in cases:
        try:
            own = LookaheadRequest(**{**_plain(case.request), "forecasters": (name,)})
            result = service.forecast(Case(case.session, own, case.tree, case.environment))
        except ExecutionError:
            scored.append(Scored(0.5, succeeded))
            continue
        scored.append(Scored(result.share, succeeded))
        costs.append(result.cost_ms)
    return scored, costs


def _plain(request: LookaheadRequest) -> Mapping[str, object]:
    return {"samples": request.samples, "threshold": request.threshold, "seed": request.seed}


def main(
    run: Annotated[Path, Argument(help="folder of a run of forecasts")],
    *,
    held_out: Annotated[int, Option(help="the last seeds, of the sessions that are foreseen")] = 20,
) -> int:
    """Learn, ask, show; exit with whether each forecaster is better than the base rate."""
    episodes = [(each.seed, Workspace.open(run / each.folder / "workspace")) for each in read_records(run)]
    unseen = sorted({seed for seed, _ in episodes})[-held_out:]
    training = [workspace for seed, workspace in episodes if seed not in unseen]
    cases = [case for seed, workspace in episodes if seed in unseen for case in read_cases(workspace)]
    model, trained = train_model(training, seed=0)
    with tempfile.TemporaryDirectory(prefix="forecasters-") as scratch:
        path = Path(scratch) / "model.json"
        path.write_bytes(encode_json(model))
        base_rate = trained.succeeded / len(trained.bundles)
        base = [Scored(base_rate, succeeded) for _, succeeded in cases]
        site = ForecasterSite(training[0], ARM, {"model": str(path)})
        foreseen = {
            "rollouts": ask("rollouts", open_forecaster("rollouts", site), cases),
            "learned": ask("learned", open_learned(site), cases),
            "base_rate": (base, [0.0]),
        }
    for name, (scored, costs) in foreseen.items():
        print("\n".join(render(name, calibrate(scored, 2), 2)))
        print(f"  {fmean(costs):.1f} ms each\n")
    reference = compute_record(base).brier
    figures = {f"brier_of_{name}": compute_record(scored).brier for name, (scored, _) in foreseen.items()}
    figures |= {f"skill_of_{name}": 1.0 - figures[f"brier_of_{name}"] / reference for name in ("rollouts", "learned")}
    figures |= {f"ms_of_{name}": fmean(foreseen[name][1]) for name in ("rollouts", "learned")}
    figures |= {"learned_from": float(len(trained.bundles)), "foreseen": float(len(cases)), "base_rate": base_rate}
    return finish(figures, ASKED)


if __name__ == "__main__":
    run(main)
