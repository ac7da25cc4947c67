"""Forecasters side by side on sessions that none of them has seen: rollouts, learned, and the base rate.

    python -m benchmarks.forecasters --seeds 60 --held-out 20
    python -m benchmarks.forecasters --seeds 60 --held-out 20 --keep FOLDER     # a second call goes on from it

The three hard scenes of the suite `lookahead` run without look-ahead, so that nothing is refused and every session has
a verdict: by cameras, as in a real run. The learned forecaster is trained on the first seeds by the kit's own code.
Both are then asked about the sessions of the held-out seeds, from their recorded estimates, through the service that a
worker asks. The base rate is the share of successes among the training sessions.
"""

import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Annotated

from rich.console import Console
from typer import Option

from benchmarks.runner import finish, run
from phyagentos.assembly.agent_plane import MemoryUse, open_agent
from phyagentos.assembly.paths import open_project
from phyagentos.assembly.planes import start_watch
from phyagentos.bench.report import Ask
from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.calibration import Scored, compute_record
from phyagentos.protocol.sessions.evidence import encode_json, read_bundle
from phyagentos.protocol.sessions.lookahead import LookaheadRequest
from phyagentos.protocol.sessions.session import GoalId
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

TASKS = ("serve", "serve_far", "balance")
ARM, TREE, MODEL = "panda", "pick_and_place", "model.json"
PLAIN = {"defaults.lookahead": "null", "defaults.max_replans": "0"}
FIRST_SEED = 300  # those below were used while look-ahead was made
ASKED = {"skill_of_rollouts": Ask(0.0, at_least=True), "skill_of_learned": Ask(0.0, at_least=True)}


def run_sessions(root: Path, seeds: Sequence[int], console: Console) -> Workspace:
    """One session of every task and seed, in one workspace; those that it holds already are only reported."""
    clock, workspace = SystemClock(), open_project(root, ROOT)
    with start_watch(workspace, pictures=False).running(clock) as plane:
        options = {"memory_use": MemoryUse.NONE, "is_runtime_alive": plane.is_alive}
        with open_agent(workspace, clock, by="bench", **options) as agent:  # type: ignore[arg-type]
            for seed in seeds:
                for task in TASKS:
                    graph = ROOT / "benchmarks" / "lookahead_parts" / f"{task}.yaml"
                    report = agent.mission.run(graph, seed=seed, goal=GoalId(f"{task}-{seed}"), overrides=PLAIN)
                    console.print(f"{task} seed {seed}: {report.verdict}", style="dim")
    return workspace


def read_cases(workspace: Workspace, seeds: Sequence[int]) -> list[tuple[Case, bool]]:
    """The sessions of these seeds as questions, and whether each succeeded."""
    found = []
    for status, outcome in iter_outcomes(workspace):
        session, execution = status.contract, status.execution
        if session.scene.seed not in seeds or session.purpose or execution is None:
            continue
        before = read_bundle(workspace.evidence_of(session.id), session, execution, with_course=False).before
        if before is not None:
            seed = compute_seed(session.scene.seed, "forecast", session.node)
            request = LookaheadRequest(samples=16, threshold=0.8, seed=seed)
            found.append((Case(session=session, request=request, tree=TREE, environment=before), not outcome))
    return found


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
    *,
    seeds: Annotated[int, Option(help="of the sessions that are learned from")] = 60,
    held_out: Annotated[int, Option(help="further seeds, of the sessions that are foreseen")] = 20,
    keep: Annotated[
        Path | None, Option(help="folder that keeps the sessions; one that holds them is gone on from")
    ] = None,
) -> int:
    """Run, learn, ask, show; exit with whether each forecaster is better than the base rate."""
    console = Console(stderr=True)
    with tempfile.TemporaryDirectory(prefix="forecasters-") as scratch:
        folder = keep or Path(scratch)
        middle = FIRST_SEED + seeds
        training = run_sessions(folder / "training", range(FIRST_SEED, middle), console)
        unseen = range(middle, middle + held_out)
        cases = read_cases(run_sessions(folder / "held_out", unseen, console), unseen)
        model, trained = train_model([training], seed=0)
        (training.root / MODEL).write_bytes(encode_json(model))
        base_rate = trained.succeeded / len(trained.bundles)
        base = [Scored(base_rate, succeeded) for _, succeeded in cases]
        site = ForecasterSite(training, ARM, {"model": MODEL})
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
