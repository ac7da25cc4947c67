"""Real sessions of nine shipped skills, carried out once: the runs that all cases of the truth table begin from.

Each is the ordinary runner with its skill, planner, guard and world, in one process. What the controller reported is
taken from here, and so are trace, held conditions and the state in which the world was left.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.oracle.moment import read_state
from benchmarks.recorded import Robot, open_stand
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.protocol.predicates.predicate import substitute
from phyagentos.protocol.sessions.evidence import INITIAL, TERMINAL, Bundle, read_bundle
from phyagentos.protocol.sessions.session import GoalId, Limits, Scene, Session, SessionId
from phyagentos.protocol.world.faults import FaultFile
from phyagentos.protocol.world.scenes import read_scene
from phyagentos.protocol.world.seeds import compute_seed
from phyagentos.runtime.models.scene import draw_bodies
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.process import LocalPlanner

CUBES = "tabletop/cubes_and_trays"
BLOCKS = "tabletop/stacking"
CUP = "tabletop/cup_transport"
TWINS = "twins"
DRAWER = "tabletop/drawer"
COASTERS = "coasters"
PUSHES_M = ((-0.06, -0.05), (-0.07, 0.02), (0.06, -0.04), (0.03, 0.07), (-0.02, -0.08), (0.08, 0.02))
"""Ways to push a thing, tried in this order until one is free."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One session that is recorded.

    Attributes:
        name: Of the job, as the table shows it.
        skill: Carried out and judged.
        given: Its arguments.
        first: Sessions that come before it in the same world: skill and arguments.
        accept: Beside what the skill guarantees.
        hold: Beside what the skill holds.
        fault: What strikes, as in a fault file; empty for nothing.
        unlisted: Things that the inventory does not know; only cameras show them, without their names.
    """

    name: str
    scene: str
    skill: str
    given: dict[str, Any]
    first: tuple[tuple[str, dict[str, Any]], ...] = ()
    accept: tuple[str, ...] = ()
    hold: tuple[str, ...] = ()
    fault: tuple[dict[str, Any], ...] = ()
    unlisted: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Recorded:
    """One session as it was left.

    Attributes:
        bundle: As the verifier reads it.
        before: mjSTATE_INTEGRATION vector before the first command.
        after: The same at the end.
    """

    job: Job
    seed: int
    bundle: Bundle
    before: np.ndarray = field(repr=False)
    after: np.ndarray = field(repr=False)


def list_jobs(number: int) -> tuple[Job, ...]:
    """The jobs of one seed; objects and destinations go round with its number."""
    colors = ("red", "green", "blue")
    color, other = colors[number % 3], colors[(number + 1) % 3]
    cube, tray = f"{color}_cube", f"{color}_tray"
    still = ("not moved(*)",)
    return (
        Job(name="home", scene=CUBES, skill="home", given={}, accept=still),
        Job(name="survey", scene=CUBES, skill="home", given={}, accept=(f"not inside(*, {other}_tray)",)),
        Job(
            name="strangers",
            scene=CUBES,
            skill="home",
            given={"object": cube},
            accept=(f"not inside(*, {other}_tray)",),
            unlisted=(cube,),
        ),
        Job(name="stand", scene=COASTERS, skill="home", given={}, accept=("tilt(blue_block) <= 0.1",)),
        Job(name="inspect", scene=CUBES, skill="inspect", given={"object": cube}, accept=still),
        Job(name="pick", scene=CUBES, skill="pick", given={"object": cube}),
        Job(
            name="pick_and_place",
            scene=CUBES,
            skill="pick_and_place",
            given={"object": cube, "destination": tray},
            accept=(f"not moved({other}_cube)",),
        ),
        Job(
            name="twins",
            scene=TWINS,
            skill="pick_and_place",
            given={"object": ("one_cube", "other_cube")[number % 2], "destination": "tray"},
        ),
        Job(
            name="place",
            scene=CUBES,
            skill="place",
            given={"object": cube, "destination": tray, "relation": "inside"},
            first=(("pick", {"object": cube}),),
        ),
        Job(name="push", scene=CUBES, skill="push", given={"object": cube, "to": None}),
        Job(
            name="stack",
            scene=BLOCKS,
            skill="stack",
            given={"object": "blue_block", "support": "red_block"},
            accept=("not moved(red_block)",),
        ),
        Job(
            name="stack_round",
            scene=COASTERS,
            skill="stack",
            given={"object": "blue_block", "support": "coaster"},
            accept=("not moved(red_block)",),
        ),
        Job(
            name="stack_frame",
            scene=COASTERS,
            skill="stack",
            given={"object": "blue_block", "support": "step"},
            accept=("not moved(red_block)",),
        ),
        Job(
            name="carry_level",
            scene=CUP,
            skill="carry_level",
            given={
                "object": "cup",
                "destination": "right_coaster",
                "relation": "on",
                "tilt_max": 0.08,
                "method": "casadi",
            },
            accept=("count(inside(*, cup)) >= 8",),
            hold=("tilt(cup) <= 0.15",),
        ),
        Job(name="close_drawer", scene=DRAWER, skill="close_drawer", given={"drawer": "drawer", "handle": "handle"}),
        Job(
            name="pick_and_place",
            scene=CUBES,
            skill="pick_and_place",
            given={"object": cube, "destination": tray},
            accept=(f"not moved({other}_cube)",),
            fault=({"kind": "slip", "object": cube, "when": {"lifted_m": 0.05}},),
        ),
    )


class Studio:
    """Carries sessions out.

    Args:
        robot: Who does it.
        folder: Where the bundles go.
    """

    def __init__(self, robot: Robot, folder: Path) -> None:
        self._robot, self._folder = robot, folder
        self._planner = LocalPlanner(MotionPlanner(robot.profile, robot.folder))

    def record(self, job: Job, seed: int) -> Recorded:
        """One job in a fresh world; a push in the first direction that is free, or in the last one."""
        if job.skill != "push":
            return self._record(job, seed)
        spec = read_scene(self._robot.library.get_scene(job.scene))
        place = next(each for each in draw_bodies(spec, seed) if each.name == job.given["object"]).position_m
        for dx, dy in PUSHES_M:
            to = (round(place[0] + dx, 4), round(place[1] + dy, 4), round(place[2], 4))
            recorded = self._record(replace(job, given={**job.given, "to": to}), seed)
            if recorded.bundle.execution.ended == "completed":
                break
        return recorded

    def _record(self, job: Job, seed: int) -> Recorded:
        faults = FaultFile.model_validate({"version": 1, "faults": list(job.fault)})
        with open_stand(self._robot, self._planner, faults, self._folder) as stand:
            for session in self._iter_sessions(job, seed):
                execution = stand.run(session)
        folder = self._folder / execution.evidence
        before, after = (read_state(folder / name) for name in (INITIAL, TERMINAL))
        return Recorded(job, seed, read_bundle(folder, session, execution), before, after)

    def _iter_sessions(self, job: Job, seed: int) -> Iterator[Session]:
        strike = "-fault" if job.fault else ""
        episode = f"{job.name}{strike}-{seed}"
        steps = (*job.first, (job.skill, job.given))
        for number, (name, given) in enumerate(steps):
            skill, _ = read_skill(self._robot.library.get_skill(name))
            is_last = number == len(steps) - 1
            known = {**given, "target": self._robot.profile.target}
            promised = (substitute(text, known) for text in (*(job.accept if is_last else ()), *skill.guarantees))
            held = (substitute(text, known) for text in (*skill.hold, *(job.hold if is_last else ())))
            yield Session(
                id=SessionId(f"{episode}.{number}"),
                goal=GoalId(episode),
                node=str(number),
                objective=skill.description,
                skill=name,
                target=self._robot.profile.target,
                parameters=dict(given),
                accept=tuple(text.replace("(target,", f"({self._robot.profile.target},") for text in promised),
                hold=tuple(held),
                scene=Scene(name=job.scene, seed=seed, episode=episode),
                seed=compute_seed(seed, job.name, number),
                limits=Limits(),
            )
