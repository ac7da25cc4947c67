"""Generated worlds and goals: stacks, full trays, drawers; and goals that cannot be reached, each for a known reason.

What can be reached is known by construction: the goal is what a random walk of valid moves, made with the independent
kinematics, has led to.
"""

import copy
import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from benchmarks.worlds.files import write_project
from benchmarks.worlds.kinematics import Invalid, Kinematics
from phyagentos.agent.goals.spec import WantedGoal
from phyagentos.assembly.scene_start import draw_start
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.world.environment import Environment

ROBOT = {"arm": "panda"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """One problem.

    Attributes:
        lack: Why it cannot be solved, as `UnreachableReason` says; empty for one that can.
    """

    family: str
    wanted: WantedGoal
    world: Environment
    seed: int
    lack: str = ""


def write_task(family: str, seed: int, folder: Path) -> Task:
    """Write the scene of a task into a project folder; read it back, and draw a goal."""
    chance = random.Random(f"{family} {seed}")
    scene, draw_goal = FAMILIES[family](chance)
    name = f"planning/{family}_{seed}"
    path = folder / "scenes" / f"{name}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(scene | {"scene": name}, sort_keys=False), encoding="utf-8")
    world = draw_start(Library.open(folder), name, ROBOT.values(), seed)
    accept, steps, constraints, lack = draw_goal(Kinematics(world), chance)
    wanted = WantedGoal(
        goal=f"{family}_{seed}",
        objective=f"{family}, drawn with seed {seed}.",
        scene=name,
        targets=ROBOT,
        constraints=constraints,
        steps=steps,
        accept=accept,
    )
    return Task(family=family, wanted=wanted, world=world, seed=seed, lack=lack)


Goal = tuple[tuple[str, ...], tuple[tuple[str, ...], ...], tuple[str, ...], str]
Scene = dict[str, Any]
DrawGoal = Callable[[Kinematics, random.Random], Goal]


def _read(name: str) -> Scene:
    path = find_shipped_root() / "scenes" / "tabletop" / f"{name}.yaml"
    data: Scene = yaml.safe_load(path.read_text(encoding="utf-8"))
    return dict(data, bodies={name: copy.deepcopy(body) for name, body in data["bodies"].items()})


def _stacks(chance: random.Random) -> tuple[Scene, DrawGoal]:
    """Blocks in stacks become other stacks."""
    scene = _read("stacking")
    names = ["red_block", "green_block", "blue_block", "yellow_block"]
    _pile(scene, names, chance, [each for each in range(1, 5) if each != 2])
    return scene, lambda kinematics, chance: _walk(kinematics, chance, names, ["pad"], 12)


def _towers(chance: random.Random) -> tuple[Scene, DrawGoal]:
    """One tower, then the same blocks in another order: steps are reached one after the other."""
    scene = _read("stacking")
    names = ["red_block", "green_block", "blue_block", "yellow_block"]

    def draw(kinematics: Kinematics, chance: random.Random) -> Goal:
        first, second = (chance.sample(names, chance.choice((3, 4))) for _ in range(2))
        towers = [tuple(f"on({a}, {b})" for a, b in zip(t, ["pad", *t], strict=False)) for t in (first, second)]
        return (towers[1], (towers[0],), (), "")

    return scene, draw


def _trays(chance: random.Random) -> tuple[Scene, DrawGoal]:
    """Small trays, each full with one cube, whose cubes change places."""
    scene, names, trays = _fill_trays(chance, chance.choice((2, 3)))

    def draw(kinematics: Kinematics, chance: random.Random) -> Goal:
        shift = chance.randrange(1, len(trays))
        accept = [f"inside({name}, {trays[(i + shift) % len(trays)]})" for i, name in enumerate(names)]
        return (tuple(accept), (), ("upright(bottle)",), "")

    return scene, draw


def _mixed(chance: random.Random) -> tuple[Scene, DrawGoal]:
    """Cubes between full trays, the table and each other's tops."""
    scene, names, trays = _fill_trays(chance, 3)
    names += ["yellow_cube"]
    return scene, lambda kinematics, chance: _walk(kinematics, chance, names, trays, 10)


def _drawer(chance: random.Random) -> tuple[Scene, DrawGoal]:
    """A closed drawer with a cube in it, and one outside: they change places, and the drawer is closed again."""
    scene = _read("drawer")
    bodies = scene["bodies"]
    bodies["drawer"]["joint"]["opening"] = [0.0, 0.0]
    for solid in bodies["cabinet"]["shapes"][1:]:  # a higher one, for objects that a hand can take out from above
        solid["position_m"][2] += 0.03 if solid["size_m"][2] < 0.01 else 0.015
        solid["size_m"][2] += 0.0 if solid["size_m"][2] < 0.01 else 0.015
    for name in ("green_cube", "blue_cube"):
        bodies[name]["shapes"] = [{"kind": "box", "size_m": [0.015, 0.015, 0.03]}]
    bodies["green_cube"]["place"] = {"frame": "drawer", "position_m": [-0.04, 0.0, 0.0342]}
    bodies["blue_cube"]["place"]["position_m"] = [0.0, 0.0, 0.0302]

    def draw(kinematics: Kinematics, chance: random.Random) -> Goal:
        change = ("not inside(green_cube, drawer)", "inside(blue_cube, drawer)")
        tower = ("on(green_cube, blue_cube)",)
        step, end = (change, "closed(drawer)") if chance.random() < 0.6 else (tower, "closed(drawer)")
        return ((end, *step[:1]), (step,), (), "")

    return scene, draw


def _overfull(chance: random.Random) -> tuple[Scene, DrawGoal]:
    """More into a tray than it holds."""
    scene, names, trays = _fill_trays(chance, 2)
    return scene, lambda k, c: (tuple(f"inside({each}, {trays[0]})" for each in names), (), (), "room")


def _circle(chance: random.Random) -> tuple[Scene, DrawGoal]:
    """Each on the next one, and the last on the first."""
    names = chance.sample(["red_block", "green_block", "blue_block", "yellow_block"], chance.choice((2, 3)))
    pairs = zip(names, [*names[1:], names[0]], strict=True)
    accept = tuple(f"on({a}, {b})" for a, b in pairs)
    return _read("stacking"), lambda k, c: (accept, (), (), "contradiction")


def _unpromised(chance: random.Random) -> tuple[Scene, DrawGoal]:
    """What no skill guarantees."""
    name = chance.choice(("red_block", "blue_block"))
    return _read("stacking"), lambda k, c: ((f"near({name}, pad, 0.01)",), (), (), "predicate")


def _forbidden(chance: random.Random) -> tuple[Scene, DrawGoal]:
    """What blocks must not be moved."""
    scene = _read("stacking")
    _pile(scene, ["red_block", "blue_block"], chance, [2])
    low, high = sorted(("red_block", "blue_block"), key=lambda name: "frame" in scene["bodies"][name]["place"])
    accept = (f"on({low}, pad)", "on(green_block, yellow_block)")
    return scene, lambda k, c: (accept, (), (f"not moved({high})",), "constraint")


def _handless(chance: random.Random) -> tuple[Scene, DrawGoal]:
    """A drawer without a handle."""
    scene = _read("drawer")
    bodies = scene["bodies"]
    bodies["drawer"]["joint"]["opening"] = [0.0, 0.0]
    del bodies["handle"]
    bodies["green_cube"]["place"] = {"frame": "drawer", "position_m": [-0.035, 0.0, 0.0202]}
    return scene, lambda k, c: (("on(green_cube, blue_cube)",), (), (), "precondition")


def _crowded(chance: random.Random) -> tuple[Scene, DrawGoal]:
    """Two cubes in two full trays on a table that has no spot beside them."""
    scene, names, trays = _fill_trays(chance, 2)
    bodies = scene["bodies"]
    for name in [each for each in bodies if each not in {"table", "floor", *names, *trays}]:
        bodies.pop(name)
    table = bodies["table"]
    table["place"], table["shapes"] = {"position_m": [0.5, 0.2, -0.02]}, [{"kind": "box", "size_m": [0.05, 0.05, 0.02]}]
    accept = (f"inside({names[0]}, {trays[1]})", f"inside({names[1]}, {trays[0]})")
    return scene, lambda k, c: (accept, (), (), "room")


def write_forgotten(seed: int, folder: Path) -> Path:
    """A goal graph, by its author, that takes a closed drawer for an open one: it has to be planned anew."""
    scene = _read("drawer")
    scene["bodies"]["drawer"]["joint"]["opening"] = [0.0, 0.0]
    name = f"planning/forgotten_{seed}"
    node = {"skill": "pick_and_place", "target": "arm", "with": {"object": "blue_cube", "destination": "drawer"}}
    graph = {"goal": f"forgotten_{seed}", "objective": "Put the blue cube into the drawer.", "scene": name}
    graph |= {"targets": ROBOT, "sessions": {"fill": node}, "accept": ["inside(blue_cube, drawer)"]}
    return write_project(folder, scene | {"scene": name}, graph)


def _pile(scene: Scene, names: list[str], chance: random.Random, heights: list[int]) -> None:
    """Blocks in stacks: each on the one before it, or on the table."""
    order = chance.sample(names, len(names))
    height, below = chance.choice(heights), ""
    for index, name in enumerate(order):
        body = copy.deepcopy(scene["bodies"].pop(name))
        if below and index % max(height, 1):
            rise = scene["bodies"][below]["shapes"][0]["size_m"][2] + body["shapes"][0]["size_m"][2]
            body["place"] = {"frame": below, "position_m": [0.0, 0.0, rise]}
        scene["bodies"][name], below = body, name


def _fill_trays(chance: random.Random, count: int) -> tuple[Scene, list[str], list[str]]:
    """Trays with room for one cube, each with one in it."""
    scene = _read("cubes_and_trays")
    bodies = scene["bodies"]
    trays = chance.sample(["red_tray", "green_tray", "blue_tray"], count)
    names = chance.sample(["red_cube", "green_cube", "blue_cube"], count)
    x, y, rim = 0.034, 0.05, 0.0025
    walls = [((rim, y, 0.005), (s * (x + rim), 0.0, 0.01)) for s in (1, -1)]
    walls += [((x, rim, 0.005), (0.0, s * (y + rim), 0.01)) for s in (1, -1)]
    solids = [{"kind": "box", "size_m": [x + rim, y + rim, 0.0025], "position_m": [0.0, 0.0, 0.0025]}]
    solids += [{"kind": "box", "size_m": [*size], "position_m": [*at]} for size, at in walls]
    for tray, name in zip(trays, names, strict=True):
        bodies[tray]["shapes"] = solids
        bodies[tray]["interior"] = {"center_m": [0.0, 0.0, 0.02], "half_m": [x, y, 0.015]}
        bodies[name]["place"] = {"frame": tray, "position_m": [0.0, 0.0, 0.0302]}
    for name in ("red_cube", "green_cube", "blue_cube", "yellow_cube"):
        bodies[name]["shapes"] = [{"kind": "box", "size_m": [0.025, 0.025, 0.025]}]
        if name not in names:
            bodies[name]["place"]["position_m"] = [0.0, 0.0, 0.0252]
    return scene, names, trays


def _walk(kinematics: Kinematics, chance: random.Random, names: list[str], places: list[str], moves: int) -> Goal:
    """Where objects are after some valid moves."""
    texts = [f"{rel}({a}, {b})" for a in names for b in sorted({*names, *places} - {a}) for rel in ("inside", "on")]
    texts = [text for text in texts if not text.startswith("on(") or not text.endswith("_tray)")]
    initial = {text for text in texts if kinematics.holds(text)}
    done = 0
    for _ in range(500):
        name, place = chance.choice(names), chance.choice([*names, *places, "table"])
        before = kinematics.world
        try:
            if name == place:
                continue
            holder = before.entities[place]
            kinematics.put_inside(name, place) if holder.interior else kinematics.put_on(name, place)
            done += 1
        except Invalid:
            kinematics.world = before
        known = [text for text in texts if kinematics.holds(text)]
        if done >= moves and len(set(known) - initial) >= 3:
            return (tuple(known), (), (), "")
    raise ValueError("no walk leads far enough")


SOLVABLE: dict[str, Callable[[random.Random], tuple[Scene, DrawGoal]]] = {
    "stacks": _stacks,
    "towers": _towers,
    "trays": _trays,
    "mixed": _mixed,
    "drawer": _drawer,
}
UNSOLVABLE: dict[str, Callable[[random.Random], tuple[Scene, DrawGoal]]] = {
    "overfull": _overfull,
    "circle": _circle,
    "unpromised": _unpromised,
    "forbidden": _forbidden,
    "handless": _handless,
    "crowded": _crowded,
}
FAMILIES = SOLVABLE | UNSOLVABLE
