"""Does experience help? Frozen evaluation, adaptation on other seeds, frozen evaluation again, and once more emptied.

    python benchmarks/evolution.py

A bench with systematic traps, all of them physics of `scenes/tabletop/workbench.yaml` or lies of its sensors: soap that
slips at full speed, an ingot that is too heavy for it, a rack whose nearest place is a chute, a puck about which all
cameras lie alike (`faults/cameras_askew.yaml`); and a cube without a trap, which must not get worse. What is learned is
what the replanner found and the verifier confirmed on the training seeds; nothing is planted. Sensing is perceived.
Evaluations allow no replan and write nothing to memory. A thing counts only when the recorded simulator state has it in
its place, whatever the verdict was. Before and after are compared by McNemar's exact test over the same seeds (McNemar
1947, doi:10.1007/BF02295996). Paper sections 4.3 and 4.4.
"""

import argparse
import hashlib
import itertools
import shutil
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
import yaml
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

from phyagentos.assembly.agent_plane import MemoryUse, open_agent
from phyagentos.assembly.paths import open_project
from phyagentos.assembly.planes import Plane, start_watch
from phyagentos.bench.report import Ask, Rate, format_outcome
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.session import GoalId, SessionId
from phyagentos.protocol.settings.perception import Sensing
from phyagentos.protocol.workspace.workspace import Workspace

ROOT = Path(__file__).resolve().parents[1]
PARTS = Path(__file__).resolve().parent / "evolution_parts"
GRAPHS = (PARTS / "workbench.yaml", PARTS / "workbench_askew.yaml")
FAULTS = ROOT / "faults" / "cameras_askew.yaml"  # strikes in goals of the second graph only
SCENE = ROOT / "scenes" / "tabletop" / "workbench.yaml"
FAMILIES = {  # node of the goal graph -> what it puts where
    "soap": ("soap", "left_tray"),
    "ingot": ("ingot", "right_tray"),
    "tin": ("tin", "rack"),
    "puck": ("puck", "left_tray"),
    "cube": ("cube", "back_tray"),
}
TRAINING, HELD_OUT = 10, 16  # seeds; those of the evaluation follow those of the training
REST_SPEED_M_S = 0.05
FLOOR_SLACK_M = 0.004
HASHED = ("safety.yaml", "sensors.yaml", "perception.yaml", "runtime_contract.yaml", "SKILLRUNTIME.md", "TARGETS.md")
ASKED = {
    "gain": Ask(0.25, at_least=True),
    "p_value": Ask(0.01, at_least=False),
    "families_worse": Ask(0.0, at_least=False),
    "left_when_emptied": Ask(0.05, at_least=False),
    "p_value_emptied": Ask(0.01, at_least=False),
    "written_while_frozen": Ask(0.0, at_least=False),
}
QUICK = {name: ASKED[name] for name in ("gain", "families_worse", "left_when_emptied", "written_while_frozen")}

Cases = dict[tuple[str, int], bool]  # family and seed -> whether the first attempt put it in its place


@dataclass(slots=True)
class Pass:
    """One pass over seeds.

    Attributes:
        name: What it is called.
        cases: What the recorded world says of first attempts.
        false_success: Verdicts of success that the recorded world denies.
        advised: First attempts that memory advised.
        version: Of the memory, when it began.
    """

    name: str
    cases: Cases = field(default_factory=dict)
    false_success: int = 0
    advised: int = 0
    version: str = ""


def run_pass(
    workspace: Workspace, plane: Plane, name: str, plan: Sequence[tuple[int, Path]], *, learns: bool, console: Console
) -> Pass:
    """Every seed of every goal graph once, on the ordinary path.

    Args:
        workspace: Whose memory advises.
        plane: The runtime plane that watches it.
        name: Of the pass; goals are named after it.
        plan: Seed of the scene, and goal graph.
        learns: Whether sessions may be replanned and verdicts are remembered.
        console: For progress.
    """
    use = MemoryUse.LEARN if learns else MemoryUse.READ
    overrides = {} if learns else {"defaults.max_replans": "0"}
    with open_agent(workspace, SystemClock(), by="bench", memory_use=use, is_runtime_alive=plane.is_alive) as agent:
        outcome = Pass(name, version=agent.memory_version)
        for seed, graph in plan:
            goal = GoalId(f"{name}-{graph.stem}-{seed}")
            report = agent.mission.run(graph, seed=seed, overrides=overrides, goal=goal)
            for session in report.sessions:
                if session.node not in FAMILIES or session.attempt:
                    continue
                is_there = is_in_place(workspace.evidence_of(SessionId(session.id)), *FAMILIES[session.node])
                outcome.cases[session.node, seed] = is_there
                outcome.false_success += session.state == "succeeded" and not is_there
                outcome.advised += bool(agent.mission.ledger.sessions[SessionId(session.id)].contract.advised_by)
            console.print(f"{goal}: {report.verdict}", style="dim")
    return outcome


def is_in_place(folder: Path, thing: str, place: str) -> bool:
    """Whether a thing lies at rest in the interior of a place, by recorded simulator state and scene file alone.

    Args:
        folder: An evidence bundle.
        thing: Body name of a free body.
        place: Body name of a body with an interior.
    """
    if not (folder / "terminal.npz").exists():
        return False
    interior = yaml.safe_load(SCENE.read_text())["bodies"][place]["interior"]
    model = mujoco.MjModel.from_binary_path(str(folder / "scene.mjb"))
    data = mujoco.MjData(model)
    with np.load(folder / "terminal.npz") as terminal:
        data.qpos[:] = terminal["qpos"]
        data.qvel[:] = terminal["qvel"]
    mujoco.mj_kinematics(model, data)
    body, base = model.body(thing), model.body(place)
    geom = body.geomadr[0]
    corners = np.array(np.meshgrid(*([-1, 1],) * 3)).reshape(3, 8) * model.geom_size[geom][:, None]
    world = data.geom_xpos[geom][:, None] + data.geom_xmat[geom].reshape(3, 3) @ corners
    rotation = data.xmat[base.id].reshape(3, 3)
    local = rotation.T @ (world - data.xpos[base.id][:, None]) - np.array(interior["center_m"])[:, None]
    half = np.array(interior["half_m"])
    within = np.all(np.abs(local[:2].mean(axis=1)) < half[:2])
    low = local[2].min()
    at_rest = np.linalg.norm(data.qvel[body.dofadr[0] : body.dofadr[0] + 3]) < REST_SPEED_M_S
    return bool(within and -half[2] - FLOOR_SLACK_M < low < half[2] and at_rest)


def compare(before: Cases, after: Cases) -> tuple[int, int, float]:
    """McNemar's exact test: cases that became right, that became wrong, and the two-sided p value."""
    gained = sum(not before[case] and after[case] for case in before)
    lost = sum(before[case] and not after[case] for case in before)
    p = float(binomtest(gained, gained + lost, 0.5).pvalue) if gained + lost else 1.0
    return gained, lost, p


def count(cases: Mapping[tuple[str, int], bool], family: str = "") -> Rate:
    """Successes of one family, or of all."""
    chosen = [value for (name, _), value in cases.items() if family in {"", name}]
    return Rate(sum(chosen), len(chosen))


def hash_configuration(workspace: Workspace) -> str:
    """Of everything but memory that decides what a run does: settings, registries, goal graph, scene."""
    digest = hashlib.sha256()
    for path in (*(workspace.root / name for name in HASHED), *GRAPHS, SCENE, FAULTS):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def count_records(workspace: Workspace) -> int:
    """Bytes of the truth of memory."""
    return sum(path.stat().st_size for path in workspace.memory.rglob("*.md")) if workspace.memory.exists() else 0


def run(
    base: Path, graphs: Sequence[Path], training: int, held_out: int, console: Console
) -> tuple[list[Pass], Workspace, int]:
    """The four passes; also how many bytes the frozen ones added to memory."""
    workspace = open_project(base / "bench", ROOT)
    train, test = range(training), range(training, training + held_out)
    passes: list[Pass] = []
    written = 0

    def evaluate(name: str) -> None:
        nonlocal written
        bytes_before = count_records(workspace)
        plan = list(itertools.product(test, graphs))
        passes.append(run_pass(workspace, plane, name, plan, learns=False, console=console))
        written += count_records(workspace) - bytes_before

    with start_watch(workspace, faults=FAULTS, pictures=False, sense=Sensing.PERCEIVED).running(SystemClock()) as plane:
        evaluate("before")
        plan = list(itertools.product(train, graphs))
        passes.append(run_pass(workspace, plane, "adaptation", plan, learns=True, console=console))
        evaluate("after")
        shutil.move(workspace.memory, base / "memory-set-aside")
        evaluate("emptied")
        shutil.move(base / "memory-set-aside", workspace.memory)
    return passes, workspace, written


def show(console: Console, passes: Mapping[str, Pass], workspace: Workspace) -> None:
    """The tables."""
    table = Table(title="first attempts that put the thing in its place, by the recorded world")
    for column in ("", *passes, "gained / lost, p"):
        table.add_column(column)
    before, after = passes["before"].cases, passes["after"].cases
    for family in (*dict.fromkeys(name for name, _ in before), ""):
        mine = [{case: ok for case, ok in cases.items() if family in {"", case[0]}} for cases in (before, after)]
        gained, lost, p = compare(*mine)
        rates = [str(count(each.cases, family)) for each in passes.values()]
        table.add_row(family or "all", *rates, f"{gained} / {lost}, {p:.2g}")
    table.add_row("advised", *(str(each.advised) for each in passes.values()), "")
    table.add_row("memory", *(each.version for each in passes.values()), "")
    console.print(table)
    console.print(f"configuration {hash_configuration(workspace)}; verdict success that the world denies: ", end="")
    console.print(", ".join(f"{each.name} {each.false_success}" for each in passes.values()))


def main() -> int:
    """Run, show, and exit with whether every asked figure holds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--training", type=int, default=TRAINING, help="seeds to learn from")
    parser.add_argument("--held-out", type=int, default=HELD_OUT, help="seeds of each evaluation")
    parser.add_argument("--quick", action="store_true", help="one seed each, the bench without lies: does it run?")
    parser.add_argument("--keep", type=Path, help="folder for the workspace, kept afterwards")
    given = parser.parse_args()
    graphs, asked = (GRAPHS[:1], QUICK) if given.quick else (GRAPHS, ASKED)
    if given.quick:
        given.training = given.held_out = 1
    console = Console(stderr=True)
    with tempfile.TemporaryDirectory(prefix="evolution-") as scratch:
        listed, workspace, written = run(given.keep or Path(scratch), graphs, given.training, given.held_out, console)
        passes = {each.name: each for each in listed}
        show(Console(width=160), passes, workspace)
        if not given.keep:
            Console().print((workspace.lessons).read_text().count("\n## "), "entries in LESSONS.md")
    before, after, emptied = (passes[name].cases for name in ("before", "after", "emptied"))
    worse = sum(count(after, family).successes < count(before, family).successes for family in FAMILIES)
    figures = {
        "before": count(before).value,
        "after": count(after).value,
        "emptied": count(emptied).value,
        "gain": count(after).value - count(before).value,
        "p_value": compare(before, after)[2],
        "families_worse": float(worse),
        "left_when_emptied": count(emptied).value - count(before).value,
        "p_value_emptied": compare(emptied, after)[2],
        "written_while_frozen": float(written),
        "false_successes": float(sum(each.false_success for each in listed)),
        "held_out_seeds": float(given.held_out),
        "training_seeds": float(given.training),
    }
    line, holds = format_outcome(figures, asked)
    print(line)
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
