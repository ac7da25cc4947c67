"""What the path costs at each control step, beside a bare loop over the same environment.

    python -m benchmarks.overhead --environments build            # where metaworld/ and libero/ stand
    python -m benchmarks.overhead --worlds meta_world --rounds 20

The path is that of a session in its worker: a skill that has its set-points ready, safety guard, receive log, driver,
socket, the kit's own checks, the environment's step, the report back, and what is kept for the evidence; a command is
one step, and is sent while the one before is carried out. It is timed from turn to turn of the session's loop. Nothing
is planned, seen or asked of a policy meanwhile. The bare loop calls `env.step` in the environment's own Python, with
the same actions, and with the environment's own observations, which this path neither reads nor builds; beside it
stands the share over a loop that leaves them out, too. All take turns, a round each.
Where other programs want the processors, `chrt -r 5` keeps them out of it.
"""

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
import yaml
from typer import Option
from typing_extensions import override

from benchmarks.libero_parts import tasks as libero
from benchmarks.libero_parts.served import KIT, serve
from benchmarks.runner import finish, one_of, run, show_figures
from phyagentos.bench.report import Threshold
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.registries import read_target
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.session import Ended, GoalId, Limits, Scene, Session, SessionId
from phyagentos.protocol.settings.safety import TargetLimits, read_safety
from phyagentos.runtime.actions.handle import TargetSessionHandle
from phyagentos.runtime.actions.set_points import SetPoints
from phyagentos.runtime.drivers.gymnasium import open_gymnasium
from phyagentos.runtime.drivers.remote import RemoteDriver
from phyagentos.runtime.execution.context import SkillContext
from phyagentos.runtime.execution.leaf_registry import build_registry
from phyagentos.runtime.execution.skill_runtime import SkillRuntime, SkillStatus, TickResult
from phyagentos.runtime.perception.world_model import GroundTruthWorldModel
from phyagentos.runtime.targets.driver import TargetPort
from phyagentos.runtime.targets.handshake import greet, mint
from phyagentos.runtime.targets.receive_log import ReceiveLog
from phyagentos.runtime.targets.served_target import ServedTarget
from phyagentos.runtime.targets.server import Loopback
from phyagentos.runtime.targets.websocket import connect_websocket
from phyagentos.runtime.worker.embodiment import Embodiment, SkillLoader
from phyagentos.runtime.worker.heartbeat import HeartbeatWriter
from phyagentos.runtime.worker.recorder import Bundles
from phyagentos.runtime.worker.runner import SessionRunner

ASKED = {
    "meta_world_added_ms": Threshold(1.0, at_least=False),
    "libero_added_share": Threshold(0.05, at_least=False),
    "libero_added_share_unobserved": Threshold(0.05, at_least=False),
}
META_WORLD = find_shipped_root() / "examples" / "projects" / "08_meta_world"
SCENES = {"meta_world": "reach-v3", "libero": "libero_object/0"}
BARE = Path(__file__).parent / "overhead_parts" / "bare.py"
WARM = 20  # steps of each round that are not counted
SWAY, RISE_S = 0.02, 1.0  # amplitude [m or rad], and how long it grows

Row = tuple[list[float], list[float], float]  # positions, velocities, opening


@dataclass(slots=True)
class Sway:
    """A skill that sways each joint about where it stands; its set-points wait for nothing."""

    context: SkillContext
    left: int
    rows: list[Row]
    _time_s: float = field(default=0.0, init=False)

    def tick(self) -> TickResult:
        """The next control period."""
        if not self.left:
            return TickResult(SkillStatus.SUCCEEDED)
        self.left -= 1
        commands = self.context.commands
        times_s = self._time_s + commands.step_s * np.arange(1, commands.n_steps + 1)
        self._time_s = float(times_s[-1])
        rise = np.minimum(times_s / RISE_S, 1.0)
        size, rate = SWAY * rise**2 * (3.0 - 2.0 * rise), SWAY * 6.0 * rise * (1.0 - rise) / RISE_S
        phase = 2.0 * times_s
        ones = np.ones_like(commands.q_rad)
        points = SetPoints(
            q_rad=commands.q_rad + np.outer(size * np.sin(phase), ones),
            qd_rad_s=np.outer(rate * np.sin(phase) + 2.0 * size * np.cos(phase), ones),
            gripper_width_m=np.full(commands.n_steps, commands.gripper_width_m),
        )
        widths = points.gripper_width_m.tolist()
        self.rows += zip(points.q_rad.tolist(), points.qd_rad_s.tolist(), widths, strict=True)
        return TickResult(SkillStatus.RUNNING, points, "sway", goes_on=self.left > 1)

    def wait(self, timeout_s: float) -> None:
        """It never thinks."""

    def halt(self) -> None:
        """Nothing runs beside."""

    def read_outputs(self) -> dict[str, Any]:
        """None."""
        return {}

    def find_failure(self) -> None:
        """It never fails."""

    def trace(self) -> tuple[()]:
        """None."""
        return ()

    def close(self) -> None:
        """Nothing is open."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SwayLoader(SkillLoader):
    """Opens it for every session; `rows` has what was commanded."""

    rows: list[Row] = field(default_factory=list)

    @override
    def open(self, session: Session, plan: Any, context: SkillContext) -> SkillRuntime:
        return Sway(context, int(session.parameters["steps"]), self.rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class World:
    """A target on an environment.

    Attributes:
        python: Of the environment.
        settings: Of its body in the kit.
        open: Its driver.
    """

    scene: str
    python: Path
    settings: dict[str, Any]
    profile: TargetProfile
    limits: TargetLimits
    library: Library
    open: Callable[[], TargetPort]


@contextmanager
def open_meta_world(environments: Path, folder: Path) -> Iterator[World]:
    """Meta-World by the driver `gymnasium`, as in its example."""
    robot = META_WORLD / "robots" / "sawyer"
    settings = yaml.safe_load((robot / "gymnasium.yaml").read_text())
    python = environments / settings.pop("environment") / "bin" / "python"
    (folder / "gymnasium.yaml").write_text(yaml.safe_dump(settings | {"python": str(python.absolute())}))
    profile = read_target(robot / "target.yaml")
    yield World(
        settings=settings | {"target": profile.target, "step_s": profile.physics_step_s},
        scene=SCENES["meta_world"],
        python=python,
        profile=profile,
        limits=read_safety(META_WORLD / "protocol" / "safety.yaml").targets[profile.target],
        library=Library.open(META_WORLD),
        open=lambda: open_gymnasium(profile, folder),
    )


@contextmanager
def open_libero(environments: Path, folder: Path) -> Iterator[World]:
    """A task of LIBERO by the driver `remote`, as in `benchmarks.libero`."""
    profile, python, scene = libero.read_profile(), environments / "libero" / "bin" / "python", SCENES["libero"]
    with serve(python.absolute(), profile, scene, folder / "outcomes.jsonl") as server:

        def open_remote() -> TargetPort:
            channel = connect_websocket(server.endpoint)
            greet(channel, mint(server.key))
            return RemoteDriver(profile, channel, server.key)

        yield World(
            settings={"target": profile.target, "scene": scene, "velocity_rad_s": profile.arm.velocity_rad_s},
            scene=scene,
            python=python,
            profile=profile,
            limits=read_safety(libero.LIBRARY / "protocol" / "safety.yaml").targets[profile.target],
            library=Library.open(libero.LIBRARY),
            open=open_remote,
        )


OPENERS = {"meta_world": open_meta_world, "libero": open_libero}


def time_bare(name: str, world: World, rows: Sequence[Row], seed: int, *, is_whole: bool = True) -> list[float]:
    """How long each step took in a loop of its own, with these set-points [ms]."""
    asked = {"world": name, "settings": world.settings, "scene": world.scene, "seed": seed, "rows": rows}
    asked["is_whole"] = is_whole
    environment = os.environ | {"PYTHONPATH": str(KIT)}
    done = subprocess.run(
        [world.python, BARE], env=environment, input=json.dumps(asked), stdout=subprocess.PIPE, text=True, check=True
    )
    found: list[float] = json.loads(done.stdout.splitlines()[-1])
    return found[WARM:]


def time_path(world: World, steps: int, seed: int, folder: Path) -> tuple[list[float], Sequence[Row]]:
    """How long each turn of a session took [ms], and the rows of set-points that it commanded."""
    clock = SystemClock()
    skills = SwayLoader(planner=cast("Any", None), library=world.library, registry=build_registry(world.library))
    target = ServedTarget(world.open(), ReceiveLog(folder / "received.jsonl"))
    try:
        handle = TargetSessionHandle(Loopback(target), world.limits, sees_truth=True)
        name, scene = world.profile.target, Scene(name=world.scene, seed=seed, episode=f"sway-{seed}")
        runner = SessionRunner(
            target=Embodiment(
                handle=handle, world=GroundTruthWorldModel(name, handle), profile=world.profile, limits=world.limits
            ),
            skills=skills,
            bundles=Bundles(folder),
            clock=clock,
        )
        handle.load(scene)
        stamps, heart = list[float](), HeartbeatWriter(folder, name, clock)

        def beat(**doing: Any) -> None:
            heart.beat(**doing)
            if doing["phase"] == "executing":
                stamps.append(time.perf_counter())

        session = _make_session(name, scene, steps)
        execution = runner.run(session, 1, {}, evidence=f"evidence/{session.id}", cancel=lambda: None, beat=beat)
        if execution.ended is not Ended.COMPLETED:
            raise RuntimeError(f"{execution.ended}: {execution.message}")
    finally:
        target.close()
    return (1e3 * np.diff(stamps[WARM:])).tolist(), skills.rows


def _make_session(target: str, scene: Scene, steps: int) -> Session:
    return Session(
        id=SessionId(f"{scene.episode}.sway"),
        goal=GoalId(scene.episode),
        node="sway",
        objective="Sway.",
        skill="sway",
        target=target,
        parameters={"steps": steps},
        accept=(),
        scene=scene,
        seed=scene.seed,
        limits=Limits(),
    )


def measure(name: str, environments: Path, rounds: int, steps: int) -> dict[str, float]:
    """The figures of one world; the rounds of both take turns."""
    bare, path, blind = list[float](), list[float](), list[float]()
    with tempfile.TemporaryDirectory() as folder, OPENERS[name](environments, Path(folder)) as world:
        for number in range(rounds):
            (where := Path(folder) / f"round{number}").mkdir()
            took_ms, rows = time_path(world, steps, number, where)
            path += took_ms
            bare += time_bare(name, world, rows, number)
            blind += time_bare(name, world, rows, number, is_whole=False) if name == "libero" else []
    both = {"bare": bare, "path": path}
    figures = {f"{name}_{which}_{at}_ms": _quantile(each, at) for which, each in both.items() for at in ("p50", "p99")}
    added = {at: figures[f"{name}_path_{at}_ms"] - figures[f"{name}_bare_{at}_ms"] for at in ("p50", "p99")}
    figures |= {f"{name}_added_ms": added["p50"], f"{name}_added_p99_ms": added["p99"]}
    figures[f"{name}_added_share"] = added["p50"] / figures[f"{name}_bare_p50_ms"]
    if blind:
        figures[f"{name}_added_share_unobserved"] = _quantile(path, "p50") / _quantile(blind, "p50") - 1.0
    return figures | {f"{name}_steps": float(len(path))}


def _quantile(values: Sequence[float], at: str) -> float:
    return float(np.quantile(values, int(at[1:]) / 100))


def main(
    *,
    environments: Path = Path("build"),
    worlds: Annotated[list[str], Option(callback=one_of(*OPENERS))] = tuple(OPENERS),
    rounds: Annotated[int, Option(help="in turn with the bare loop, as a machine drifts")] = 10,
    steps: Annotated[int, Option(help="of a round")] = 140,
) -> int:
    """Print the table and the closing line; exit with whether every asked figure holds."""
    measured = (measure(name, environments, rounds, steps) for name in worlds)
    figures = {key: value for each in measured for key, value in each.items()}
    asked = {key: ask for key, ask in ASKED.items() if key in figures}
    show_figures("A control step on the path, beside a bare loop", figures, asked)
    return finish(figures, asked)


if __name__ == "__main__":
    run(main)
