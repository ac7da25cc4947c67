"""Instances of one skill each, drawn from seeds: a scene, a goal of one node, and what must be true of the world."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

Rng = np.random.Generator
RGB = {
    "red": [0.82, 0.16, 0.14, 1],
    "green": [0.15, 0.6, 0.27, 1],
    "blue": [0.12, 0.33, 0.78, 1],
    "yellow": [0.95, 0.75, 0.12, 1],
    "purple": [0.5, 0.2, 0.6, 1],
    "white": [0.93, 0.93, 0.91, 1],
    "slate": [0.38, 0.42, 0.5, 1],
    "wood": [0.86, 0.68, 0.48, 1],
    "floor": [0.82, 0.84, 0.87, 1],
}
SURFACES = {"wood": "wood", "floor": "wood", "slate": "ceramic"}
TURN = 3.14159
STUCK, HEAVY_KG = 200.0, 40.0  # [N] or [N m]; no friction of the fingers holds so much


@dataclass(frozen=True, slots=True, kw_only=True)
class Instance:
    """One instance.

    Attributes:
        bodies: Of the scene file, beside table and floor.
        arguments: Of the skill.
        accept: Of the node.
        truth: What the oracle is asked, where that is more than `accept` (see `oracle/skill_facts.py`).
        regions: Of the scene file.
        spoilt: Bodies that a spoilt instance changes; all where none is named.
    """

    skill: str
    seed: int
    bodies: Mapping[str, dict[str, Any]]
    arguments: Mapping[str, Any]
    accept: tuple[str, ...]
    truth: tuple[str, ...] = ()
    regions: Mapping[str, Any] = field(default_factory=dict)
    spoilt: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Of scene and goal."""
        return f"{self.skill}_{self.seed}"

    def as_scene(self) -> dict[str, Any]:
        """The scene file."""
        table = [{"kind": "box", "size_m": [0.52, 0.65, 0.02]}]
        return {
            "scene": f"skills/{self.name}",
            "description": f"Drawn from seed {self.seed}.",
            "materials": {name: {"surface": SURFACES.get(name, "plastic"), "rgba": rgba} for name, rgba in RGB.items()},
            "bodies": {
                "table": fix("table", "wood", (0.38, 0.05, -0.02), table),
                "floor": fix("floor", "floor", (0.4, 0.0, -0.77), [{"kind": "box", "size_m": [3.0, 3.0, 0.02]}]),
                **self.bodies,
            },
            "regions": dict(self.regions),
            "cameras": {"overview": {"position_m": [1.85, 0.46, 1.15], "target_m": [0.27, 0.05, 0.26], "fovy_deg": 41}},
            "lights": {"key": {"position_m": [1.2, -1.2, 2.2], "direction": [-0.4, 0.55, -1.0]}},
            "settle_s": 1.0,
        }

    def as_goal(self) -> dict[str, Any]:
        """The goal graph."""
        return {
            "goal": self.name,
            "objective": f"{'; '.join(self.accept)}.",
            "scene": f"skills/{self.name}",
            "targets": {"arm": "panda"},
            "defaults": {"timeout_s": 60, "max_replans": 2},
            "sessions": {
                "only": {
                    "skill": self.skill,
                    "target": "arm",
                    "with": dict(self.arguments),
                    "accept": list(self.accept),
                }
            },
            "accept": [text for text in self.accept if not text.startswith("metric")],
        }


def fix(kind: str, material: str, at_m: tuple[float, ...], shapes: list[Any], yaw: float = 0.0) -> dict[str, Any]:
    """A fixed body."""
    place = {"position_m": [float(v) for v in at_m], "yaw_rad": [yaw, yaw]}
    return {"kind": kind, "fixed": True, "material": material, "place": place, "shapes": shapes}


def loose(kind: str, color: str, at_m: tuple[float, ...], shapes: list[Any], yaw: float, mass: float) -> dict[str, Any]:
    """A body that moves freely."""
    body = fix(kind, color, at_m, shapes, yaw) | {"color": color, "mass_kg": float(mass)}
    del body["fixed"]
    return body


def box(half_m: tuple[float, ...], at_m: tuple[float, ...] = (0.0, 0.0, 0.0)) -> dict[str, Any]:
    """One box."""
    return {"kind": "box", "size_m": [float(v) for v in half_m], "position_m": [float(v) for v in at_m]}


def draw_unstack(seed: int, rng: Rng) -> Instance:
    """The top of two or three blocks, on a pad or on the table, is put onto the table."""
    count = int(rng.integers(2, 4))
    x, y, z = rng.uniform(0.42, 0.58), rng.uniform(-0.25, 0.25), 0.0
    colors = rng.permutation(["red", "green", "blue", "yellow"])[:count]
    bodies: dict[str, dict[str, Any]] = {}
    half = rng.uniform(0.024, 0.03)
    for index, color in enumerate(colors):
        if index:
            half = rng.uniform(0.75, 1.0) * half
        tall = rng.uniform(0.017, 0.028)
        shapes = [box((half, half * rng.uniform(0.85, 1.0), tall))]
        shift = rng.uniform(-0.004, 0.004, 2) if index else (0.0, 0.0)
        at = (x + shift[0], y + shift[1], z + tall + 0.0005)
        bodies[f"{color}_block"] = loose(
            "block", str(color), at, shapes, rng.uniform(-TURN, TURN), rng.uniform(0.05, 0.2)
        )
        z += 2 * tall
    *below, top = bodies
    accept = (f"on({top}, table)", *(f"not moved({name})" for name in below))
    arguments = {"object": top, "lower": below[-1], "support": "table"}
    return Instance(skill="unstack", seed=seed, bodies=bodies, arguments=arguments, accept=accept)


def draw_lid(rng: Rng, opening: tuple[float, float]) -> tuple[dict[str, dict[str, Any]], str, str]:
    """A chest with a lid that turns about its far edge."""
    long, wide, tall = rng.uniform(0.055, 0.08), rng.uniform(0.06, 0.1), rng.uniform(0.03, 0.05)
    x, y = rng.uniform(0.52, 0.57), rng.uniform(-0.25, 0.25)
    yaw = rng.uniform(-0.35, 0.35)
    at = (x, y, 0.0)
    walls = [
        box((long, wide, 0.003), (0, 0, 0.003)),
        *(box((long, 0.003, tall), (0, s * (wide - 0.003), 0.006 + tall)) for s in (1, -1)),
        *(box((0.003, wide - 0.006, tall), (s * (long - 0.003), 0, 0.006 + tall)) for s in (1, -1)),
    ]
    joint = {
        "kind": "hinge",
        "axis": [0, 1, 0],
        "anchor_m": [float(long), 0.0, 0.0],
        "travel": float(rng.uniform(1.45, 1.65)),
        "opening": list(opening),
        "damping": 0.1,
        "friction": float(rng.uniform(0.3, 0.5)),
    }
    plate = [box((long + 0.002, wide + 0.002, 0.003)), box((0.006, 0.004, 0.003), (-long - 0.005, 0, 0))]
    lid = loose("lid", "white", (x, y, 2 * tall + 0.0105), plate, yaw, rng.uniform(0.12, 0.22)) | {"joint": joint}
    tab_half = rng.uniform(0.018, 0.024)
    tab = loose(
        "handle", "red", (-long - 0.011 - tab_half, 0, 0), [box((tab_half, rng.uniform(0.004, 0.008), 0.012))], 0, 0.03
    )
    return {"chest": fix("chest", "slate", at, walls, yaw), "lid": lid, "tab": tab | {"part_of": "lid"}}, "lid", "tab"


def draw_door(rng: Rng, opening: tuple[float, float]) -> tuple[dict[str, dict[str, Any]], str, str]:
    """A cupboard whose door turns about its left or right edge."""
    wide, tall, side = rng.uniform(0.065, 0.085), rng.uniform(0.04, 0.06), float(rng.choice([1, -1]))
    x, y = rng.uniform(0.58, 0.62), side * rng.uniform(0.12, 0.25)
    walls = [
        *(box((0.05, wide + 0.002, 0.003), (0, 0, z)) for z in (0.003, 2 * tall + 0.011)),
        *(box((0.05, 0.003, tall), (0, s * (wide - 0.001), tall + 0.007)) for s in (1, -1)),
        box((0.003, wide - 0.006, tall), (0.047, 0, tall + 0.007)),
    ]
    joint = {
        "kind": "hinge",
        "axis": [0, 0, -side],
        "anchor_m": [0.0, float(side * (wide + 0.002)), 0.0],
        "travel": float(rng.uniform(1.3, 1.7)),
        "opening": list(opening),
        "damping": 0.1,
        "friction": float(rng.uniform(0.05, 0.2)),
    }
    bar_y, radius = -side * (wide - 0.018), float(rng.uniform(0.008, 0.012))
    panel = [box((0.004, wide, tall)), *(box((0.02, 0.003, 0.003), (-0.024, bar_y, z)) for z in (0.02, -0.02))]
    door = loose("door", "white", (x - 0.055, y, tall + 0.007), panel, 0, rng.uniform(0.2, 0.4)) | {"joint": joint}
    capsule = {"kind": "capsule", "size_m": [radius, float(tall)]}
    bar = loose("handle", "green", (-0.046, bar_y, 0.016), [capsule], 0, 0.03) | {"part_of": "door"}
    return {"cupboard": fix("cabinet", "slate", (x, y, 0.0), walls), "door": door, "bar": bar}, "door", "bar"


def draw_hinged(seed: int, rng: Rng, *, opens: bool) -> Instance:
    """A lid or a door, to be opened or closed."""
    draw: Callable[..., Any] = draw_lid if rng.random() < 0.5 else draw_door
    is_lid = draw is draw_lid
    spans = ((0.0, 0.0) if is_lid else (0.05, 0.25)) if opens else ((0.9, 1.0) if is_lid else (0.5, 0.9))
    bodies, item, handle = draw(rng, spans)
    word = "open" if opens else "closed"
    return Instance(
        skill="open_hinged" if opens else "close_hinged",
        seed=seed,
        bodies=bodies,
        arguments={"object": item, "handle": handle},
        accept=(f"{word}({item})",),
    )


def draw_press(seed: int, rng: Rng) -> Instance:
    """One of two buttons on a panel; the other one must stay as it is."""
    x, y, yaw = rng.uniform(0.42, 0.58), rng.uniform(-0.25, 0.25), rng.uniform(-1.5, 1.5)
    tall, apart = rng.uniform(0.015, 0.04), rng.uniform(0.055, 0.07)
    bodies: dict[str, dict[str, Any]] = {"panel": fix("panel", "slate", (x, y, tall), [box((0.05, 0.12, tall))], yaw)}
    for name, color, side in (("start", "green", 1), ("stop", "red", -1)):
        travel = float(rng.uniform(0.036, 0.045))
        joint = {"kind": "slide", "axis": [0, 0, 1], "travel": travel, "opening": [1.0, 1.0], "damping": 10.0}
        joint |= {"friction": float(rng.uniform(4.0, 8.0)), "spring": float(rng.uniform(20.0, 100.0))}
        at = (x - side * apart * np.sin(yaw), y + side * apart * np.cos(yaw), 2 * tall + 0.004)
        stem = [{"kind": "cylinder", "size_m": [0.01, 0.003]}]
        stem.append({"kind": "cylinder", "size_m": [0.008, 0.02], "position_m": [0.0, 0.0, -0.018], "decor": True})
        bodies[name] = loose("button", "slate", at, stem, 0, 0.03) | {"joint": joint}
        cap = {"kind": "cylinder", "size_m": [float(rng.uniform(0.022, 0.03)), 0.006]}
        bodies[f"{name}_cap"] = loose("cap", color, (0, 0, 0.01), [cap], 0, 0.03) | {"part_of": name}
    wanted, other = ("start", "stop") if rng.random() < 0.5 else ("stop", "start")
    accept = (f"closed({wanted})", f"open({other})")
    arguments = {"button": wanted, "cap": f"{wanted}_cap"}
    return Instance(skill="press", seed=seed, bodies=bodies, arguments=arguments, accept=accept)


def draw_insert(seed: int, rng: Rng) -> Instance:
    """A standing peg, and a block with a hole that is two millimetres wider."""
    radius, tall, wall = rng.uniform(0.011, 0.018), rng.uniform(0.038, 0.046), 0.012
    deep = tall - rng.uniform(0.019, 0.023)  # fingers that hold the peg's upper end stay above the rim
    hole, yaw, side = radius + 0.001, rng.uniform(-TURN, TURN), float(rng.choice([1, -1]))
    outer = hole + wall
    walls = [
        box((outer, outer, 0.002), (0, 0, 0.002)),
        *(box((outer, wall / 2, deep), (0, s * (hole + wall / 2), 0.004 + deep)) for s in (1, -1)),
        *(box((wall / 2, hole, deep), (s * (hole + wall / 2), 0, 0.004 + deep)) for s in (1, -1)),
    ]
    at = (rng.uniform(0.42, 0.55), side * rng.uniform(0.05, 0.25), 0.0)
    socket = fix("socket", "slate", at, walls, yaw)
    socket["interior"] = {
        "center_m": [0.0, 0.0, 0.004 + float(deep)],
        "half_m": [float(hole), float(hole), float(deep)],
    }
    socket["place"]["jitter_m"] = [0.01, 0.01, 0.0]  # where it stands is measured
    peg_at = (rng.uniform(0.42, 0.55), -side * rng.uniform(0.05, 0.25), tall + 0.0005)
    cylinder = {"kind": "cylinder", "size_m": [float(radius), float(tall)]}
    peg = loose("peg", "red", peg_at, [cylinder], 0, rng.uniform(0.04, 0.15))
    truth = (f"plugged(peg, socket, {float(deep)}, {float(tall)})",)
    arguments = {"object": "peg", "socket": "socket"}
    accept = ("inside(peg, socket)",)
    bodies = {"socket": socket, "peg": peg}
    return Instance(skill="insert", seed=seed, bodies=bodies, arguments=arguments, accept=accept, truth=truth)


def draw_stand_up(seed: int, rng: Rng) -> Instance:
    """A bottle or a bar that lies, or a knob with a wide foot that lies or stands on its head."""
    kind, color = str(rng.choice(["bottle", "bar", "knob"])), str(rng.choice(["red", "green", "blue", "yellow"]))
    on_head = False
    if kind == "bottle":
        radius, half, neck = rng.uniform(0.022, 0.031), rng.uniform(0.035, 0.05), rng.uniform(0.01, 0.015)
        shapes = [
            {"kind": "cylinder", "size_m": [float(radius), float(half)]},
            {"kind": "cylinder", "size_m": [0.011, float(neck)], "position_m": [0.0, 0.0, float(half + neck)]},
        ]
        high = radius
    elif kind == "bar":
        a, b, half = rng.uniform(0.016, 0.03), rng.uniform(0.016, 0.03), rng.uniform(0.038, 0.055)
        shapes, high = [box((a, b, half))], b
    else:
        foot, flat = rng.uniform(0.028, 0.033), rng.uniform(0.007, 0.011)
        stem, half = rng.uniform(0.015, 0.018), rng.uniform(0.025, 0.035)
        shapes = [box((foot, foot, flat), (0, 0, flat - half)), box((stem, stem, half - flat), (0, 0, flat))]
        on_head = bool(rng.random() < 0.6)
        high = half if on_head else foot
    at = (rng.uniform(0.42, 0.56), rng.uniform(-0.25, 0.25), high + 0.001)
    body = loose(kind, color, at, shapes, rng.uniform(-TURN, TURN), rng.uniform(0.06, 0.25))
    body["place"]["euler_rad"] = [3.14159265 if on_head else 1.57079633, 0.0, 0.0]
    return Instance(
        skill="stand_up",
        seed=seed,
        bodies={kind: body},
        arguments={"object": kind, "support": "table"},
        accept=(f"upright({kind})", f"on({kind}, table)"),
    )


def draw_wipe(seed: int, rng: Rng) -> Instance:
    """An area of the table with a crumb in each of four cells, and a sponge on a dish beside it."""
    x, y, side = rng.uniform(0.44, 0.52), rng.uniform(-0.03, 0.1), float(rng.choice([1, -1]))
    half = rng.uniform(0.05, 0.075, 2)
    bodies = {"dish": fix("dish", "slate", (rng.uniform(0.42, 0.52), -side * 0.26, 0.004), [box((0.07, 0.06, 0.004))])}
    wide, long, tall = rng.uniform(0.014, 0.024), rng.uniform(0.034, 0.045), rng.uniform(0.03, 0.04)
    dish_x, dish_y = bodies["dish"]["place"]["position_m"][:2]
    at = (dish_x, dish_y, 0.009 + tall)
    bodies["sponge"] = loose("sponge", "yellow", at, [box((long, wide, tall))], rng.uniform(-TURN, TURN), 0.06)
    cells = [(i, j) for i in (-1, 1) for j in (-1, 1)]
    for color, (i, j) in zip(("red", "green", "blue", "purple"), rng.permutation(cells), strict=True):
        small = rng.uniform(0.006, 0.009)
        place = (x + i * rng.uniform(0.15, 0.85) * half[0], side * y + j * rng.uniform(0.15, 0.85) * half[1], small)
        turned = rng.uniform(-TURN, TURN)
        bodies[f"{color}_crumb"] = loose("crumb", color, place, [box((small,) * 3)], turned, rng.uniform(0.002, 0.008))
    center = [float(x), float(side * y), 0.03]
    crumbs = [name for name in bodies if name.endswith("crumb")]
    area = ", ".join(map(str, (*center[:2], *half.tolist())))
    return Instance(
        skill="wipe",
        seed=seed,
        bodies=bodies,
        arguments={"object": "sponge", "area": "spot", "support": "table", "rest": "dish"},
        accept=("not inside(*, spot)", "on(sponge, dish)", "metric(peak_force_n) <= 60"),
        truth=("on(sponge, dish)", f"swept(sponge, {area})", *(f"beside({name}, {area})" for name in crumbs)),
        regions={"spot": {"center_m": center, "half_m": [*half.tolist(), 0.03]}},
        spoilt=tuple(crumbs),
    )


def ring(radius: float, wall: float, half: float, floor: float, sides: int = 8) -> list[dict[str, Any]]:
    """An open vessel with flat walls around a round floor, from its lower end up; the radius is the inner one."""
    wide = (radius + wall) * np.tan(np.pi / sides)
    plate = {
        "kind": "cylinder",
        "size_m": [float(radius + wall / 2), float(floor / 2)],
        "position_m": [0, 0, floor / 2],
    }
    shapes = [plate]
    for turn in (2 * np.pi * index / sides for index in range(sides)):
        at = ((radius + wall / 2) * np.cos(turn), (radius + wall / 2) * np.sin(turn), floor + half)
        shapes.append(box((wall / 2, wide, half), at) | {"euler_rad": [0.0, 0.0, float(turn)]})
    return shapes


def draw_pour(seed: int, rng: Rng) -> Instance:
    """A cup with small balls, and a bowl; three quarters of the balls and more shall come to lie in the bowl."""
    count, ball, side = int(rng.integers(12, 21)), rng.uniform(0.005, 0.0065), float(rng.choice([1, -1]))
    colors = rng.permutation(["red", "green", "blue", "yellow"])  # white is the floor's
    bodies: dict[str, dict[str, Any]] = {}
    for name, sign, color, radius, half, mass in (
        ("cup", -1, colors[0], rng.uniform(0.024, 0.029), rng.uniform(0.033, 0.045), rng.uniform(0.08, 0.2)),
        ("bowl", 1, colors[1], rng.uniform(0.05, 0.065), rng.uniform(0.016, 0.024), rng.uniform(0.25, 0.5)),
    ):
        at = (rng.uniform(0.42, 0.55), sign * side * rng.uniform(0.1, 0.25), 0.0005)
        bodies[name] = loose(name, str(color), at, ring(radius, 0.003, half, 0.004), rng.uniform(-TURN, TURN), mass)
        wide = float(radius)
        bodies[name]["interior"] = {"center_m": [0, 0, 0.004 + float(half)], "half_m": [wide, wide, float(half)]}
    bodies["cup"]["contents"] = {"count": count, "radius_m": float(ball), "material": str(colors[2])}
    least = int(np.ceil(0.75 * count))
    return Instance(
        skill="pour",
        seed=seed,
        bodies=bodies,
        arguments={"object": "cup", "into": "bowl", "least": least},
        accept=(f"contains(bowl, {least})", "upright(cup)"),
        truth=(f"poured(cup, bowl, {least})", "upright(cup)"),
        spoilt=("bowl",),
    )


def draw_block_or_can(rng: Rng, at: tuple[float, float], yaw: float) -> dict[str, Any]:
    """What a hand takes, standing on the table."""
    half, mass, color = rng.uniform(0.016, 0.03), rng.uniform(0.05, 0.25), str(rng.choice(["red", "green", "blue"]))
    if rng.random() < 0.5:
        tall = rng.uniform(0.025, 0.05)
        can = {"kind": "cylinder", "size_m": [float(half), float(tall)]}
        return loose("can", color, (*at, tall + 0.001), [can], yaw, mass)
    shapes = [box((half, half * rng.uniform(0.8, 1.0), rng.uniform(0.02, 0.03)))]
    return loose("block", color, (*at, shapes[0]["size_m"][2] + 0.001), shapes, yaw, mass)


def draw_under(seed: int, rng: Rng) -> Instance:
    """An object under a board on two walls, too low for a hand from above, is put onto a pad."""
    wide, deep, tall = rng.uniform(0.17, 0.22), rng.uniform(0.05, 0.08), rng.uniform(0.08, 0.1)
    side, away, turn = float(rng.choice([1, -1])), rng.uniform(0.48, 0.58), rng.uniform(0.3, 0.7)
    x, y, yaw = away * np.cos(turn), side * away * np.sin(turn), side * turn + rng.uniform(-0.15, 0.15)
    board = [box((deep, wide, 0.006), (0, 0, 2 * tall + 0.006))]
    board += [box((deep, 0.006, tall), (0, s * (wide - 0.006), tall)) for s in (1, -1)]
    inside, beside = rng.uniform(0.0, 0.04) - deep + 0.02, rng.uniform(-1.0, 1.0) * (wide - 0.13)
    at = (x + inside * np.cos(yaw) - beside * np.sin(yaw), y + inside * np.sin(yaw) + beside * np.cos(yaw))
    pad_at = (rng.uniform(0.42, 0.5), -side * rng.uniform(0.12, 0.25), 0.004)
    bodies = {
        "shelf": fix("shelf", "slate", (x, y, 0.0), board, yaw),
        "pad": fix("pad", "slate", pad_at, [box((0.06, 0.06, 0.004))]),
        "thing": draw_block_or_can(rng, at, yaw + rng.uniform(-0.15, 0.15)),
    }
    return Instance(
        skill="stack",
        seed=seed,
        bodies=bodies,
        arguments={"object": "thing", "support": "pad"},
        accept=("on(thing, pad)",),
    )


def draw_edge(seed: int, rng: Rng) -> Instance:
    """A plate or a board, wider than fingers open, goes from one post to another."""
    bodies: dict[str, dict[str, Any]] = {}
    half, thick, side = rng.uniform(0.06, 0.08), rng.uniform(0.004, 0.008), float(rng.choice([1, -1]))
    out = rng.uniform(0.03, 0.04)  # of the plate, over what bears it
    for name, sign in (("post", 1), ("other_post", -1)):
        tall, at = rng.uniform(0.06, 0.1), (rng.uniform(0.45, 0.58), sign * side * rng.uniform(0.12, 0.25))
        bodies[name] = fix("post", "slate", (*at, tall), [box((half - out, half - out, tall))])
    *at, tall = bodies["post"]["place"]["position_m"]
    is_round = rng.random() < 0.5
    shapes = [{"kind": "cylinder", "size_m": [float(half), float(thick)]}] if is_round else [box((half, half, thick))]
    place = (*at, 2 * tall + thick + 0.0005)
    bodies["plate"] = loose("plate", "red", place, shapes, rng.uniform(-0.4, 0.4), rng.uniform(0.08, 0.25))
    return Instance(
        skill="stack",
        seed=seed,
        bodies=bodies,
        arguments={"object": "plate", "support": "other_post"},
        accept=("on(plate, other_post)",),
    )


DRAWERS: Mapping[str, Callable[[int, Rng], Instance]] = {
    "unstack": draw_unstack,
    "press": draw_press,
    "insert": draw_insert,
    "pour": draw_pour,
    "stand_up": draw_stand_up,
    "wipe": draw_wipe,
    "under": draw_under,
    "edge": draw_edge,
    "open_hinged": lambda seed, rng: draw_hinged(seed, rng, opens=True),
    "close_hinged": lambda seed, rng: draw_hinged(seed, rng, opens=False),
}


def draw(skill: str, seed: int, *, spoilt: bool = False) -> Instance:
    """The instance of a seed; a spoilt one cannot be met: stuck joints, heavy objects, bowls without room."""
    instance = DRAWERS[skill](seed, np.random.default_rng([seed, *skill.encode()]))
    if not spoilt:
        return instance
    changed = instance.spoilt or tuple(instance.bodies)
    return replace(
        instance,
        bodies={name: _spoil(body) if name in changed else body for name, body in instance.bodies.items()},
    )


def _spoil(body: dict[str, Any]) -> dict[str, Any]:
    if body["kind"] == "bowl":  # for five balls at most
        inside = {"center_m": [0.0, 0.0, 0.009], "half_m": [0.014, 0.014, 0.005]}
        return body | {"shapes": ring(0.014, 0.003, 0.005, 0.004), "interior": inside}
    if "joint" in body:
        return body | {"joint": body["joint"] | {"friction": STUCK}}
    if body.get("fixed") or "part_of" in body:
        return body
    return body | {"mass_span_kg": [HEAVY_KG, HEAVY_KG]}
