"""Pictures of a scene with the names of its objects, and with each place where an object is to be.

MUJOCO_GL selects the graphics when MuJoCo is imported.
"""

import io
import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from textwrap import shorten

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from phyagentos.geometry import Vector
from phyagentos.pictures.scene import add_geom, open_renderer

WIDTH, HEIGHT, LINE_PX, MARGIN_PX, GAP_PX, FONT_PX = 1000, 720, 22, 12, 6, 15
AZIMUTH_DEG, ELEVATION_DEG, SPARE = 180.0, -42.0, 1.25
LEAST_RADIUS_M, TALL = 0.3, 0.3  # of what is looked at; height of an arrow, as a share of its length
GHOST_ALPHA, ARROW, PAPER, INK = 0.45, (255, 138, 0), (250, 250, 248, 235), (24, 28, 32)
MOST_LINES, LETTERS, LABEL_PX = 14, 120, 11  # of a line; half the height of a label
_SIDES = ((0, -1), (0, 1), (1, 0), (-1, 0), (1, -1), (-1, -1), (1, 1), (-1, 1))
_AWAY_PX = (10, 24, 42, 64, 90, 120)

Pixel = tuple[float, float]
Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Move:
    """A body whose origin goes from one place (3,) in the world to another [m], by the numbered line of the text."""

    name: str
    from_m: Vector
    to_m: Vector
    number: int


@dataclass(frozen=True, slots=True)
class Drawing:
    """What a picture shows beside the scene: names of bodies, moves in their order, and lines of text below.

    Attributes:
        whole: Further bodies that are in view, without their names.
    """

    names: Collection[str] = ()
    whole: Collection[str] = ()
    moves: Sequence[Move] = ()
    lines: Sequence[str] = ()
    camera: str = ""


def draw_labelled(model: mujoco.MjModel, data: mujoco.MjData, drawing: Drawing) -> bytes:
    """PNG of a scene, from the front, or by the camera that is named.

    Raises:
        DefinitionError: `UNKNOWN_NAME` of a camera; `NO_GRAPHICS` where this machine cannot draw.
    """
    with open_renderer(model, drawing.camera, WIDTH, HEIGHT, "the picture") as renderer:
        mujoco.mj_camlight(model, data)
        renderer.update_scene(data, drawing.camera or _aim(model, data, drawing))
        for move in drawing.moves:
            _add_ghost(renderer.scene, model, data, move)
        image, project = Image.fromarray(renderer.render()), _make_projection(renderer.scene)
    at = {name: project(data.geom_xpos[int(model.body(name).geomadr[0])]) for name in drawing.names}
    seen = {name: (x, y) for name, (x, y) in at.items() if 0 <= x < WIDTH and 0 <= y < HEIGHT}
    _write(image, seen, {move.number: [*map(project, _trace(move))] for move in drawing.moves})
    buffer = io.BytesIO()
    _extend(image, drawing.lines).save(buffer, format="PNG")
    return buffer.getvalue()


def _make_projection(scene: mujoco.MjvScene) -> Callable[[NDArray[np.float64]], Pixel]:
    """What gives the pixel of a point (3,) of the world."""
    left, right = scene.camera
    middle_m, slope = (np.array(left.pos) + right.pos) / 2, left.frustum_top / left.frustum_near
    aside = np.cross(left.forward, left.up)

    def project(point_m: NDArray[np.float64]) -> Pixel:
        way_m = point_m - middle_m
        x, y = (HEIGHT / 2 * float(way_m @ axis / (way_m @ left.forward)) / slope for axis in (aside, left.up))
        return WIDTH / 2 + x, HEIGHT / 2 - y

    return project


def _aim(model: mujoco.MjModel, data: mujoco.MjData, drawing: Drawing) -> mujoco.MjvCamera:
    """A view from the front that holds every named body, and where each is to be."""
    bodies = [data.body(name).xpos for name in (*drawing.names, *drawing.whole)]
    points = np.array([*bodies, *(move.to_m for move in drawing.moves)])
    points = points if len(points) else np.array([[0.4, 0.0, 0.1]])
    low_m, high_m = points.min(axis=0), points.max(axis=0)
    radius_m = max(LEAST_RADIUS_M, float(np.linalg.norm(points - (low_m + high_m) / 2, axis=1).max()))
    camera = mujoco.MjvCamera()
    camera.lookat[:] = (low_m + high_m) / 2
    camera.azimuth, camera.elevation = AZIMUTH_DEG, ELEVATION_DEG
    camera.distance = SPARE * radius_m / math.sin(math.radians(model.vis.global_.fovy) / 2)
    return camera


def _add_ghost(scene: mujoco.MjvScene, model: mujoco.MjModel, data: mujoco.MjData, move: Move) -> None:
    """The solids of a body once more, translucent, where it is to be."""
    body = model.body(move.name)
    shift_m = np.array(move.to_m) - data.body(move.name).xpos
    for number in range(int(body.geomadr[0]), int(body.geomadr[0] + body.geomnum[0])):
        material = model.geom_matid[number]
        rgba = np.array(model.mat_rgba[material] if material >= 0 else model.geom_rgba[number], np.float32)
        rgba[3] = GHOST_ALPHA
        at_m, turn = data.geom_xpos[number] + shift_m, data.geom_xmat[number]
        add_geom(scene, model.geom_type[number], model.geom_size[number], at_m, turn, rgba)


def _trace(move: Move) -> NDArray[np.float64]:
    """Points (33, 3) of the bow over which an arrow goes."""
    shares = np.linspace(0.0, 1.0, 33)[:, None]
    way_m = np.subtract(move.to_m, move.from_m)
    up_m = np.array((0.0, 0.0, 0.04 + TALL * float(np.linalg.norm(way_m))))
    bow: NDArray[np.float64] = np.array(move.from_m) + shares * way_m + 4 * shares * (1 - shares) * up_m
    return bow


def _write(image: Image.Image, at: Mapping[str, Pixel], arcs: Mapping[int, list[Pixel]]) -> None:
    """Arrows, their numbers, and names beside what they name."""
    draw, font = ImageDraw.Draw(image, "RGBA"), ImageFont.load_default(FONT_PX)
    taken = [_square(point) for point in (*at.values(), *(course[-1] for course in arcs.values()))]
    for course in arcs.values():
        draw.line(course, fill=(*INK, 160), width=6, joint="curve")
        draw.line(course, fill=ARROW, width=3, joint="curve")
        (ax, ay), (bx, by) = course[-4], course[-1]
        turn = math.atan2(by - ay, bx - ax)
        wings = [(bx - 15 * math.cos(turn + side), by - 15 * math.sin(turn + side)) for side in (-0.45, 0.45)]
        draw.polygon([(bx, by), *wings], fill=ARROW, outline=INK)
    for number, course in arcs.items():
        place = next((each for each in course[8:25] if not _covers(_square(each), taken)), course[16])
        draw.ellipse(_square(place), fill=ARROW, outline=INK)
        draw.text(place, str(number), fill=INK, font=font, anchor="mm")
        taken.append(_square(place))
    boxes = place_labels(at, {name: draw.textlength(name, font=font) for name in at}, taken)
    for name, box in boxes.items():
        (x, y), middle = at[name], ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2)
        draw.line(((x, y), middle), fill=(*INK, 200), width=2)
        draw.ellipse((x - 3, y - 3, x + 3, y + 3), fill=INK)
    for name, box in boxes.items():
        draw.rounded_rectangle(box, 5, fill=PAPER, outline=INK)
        draw.text(((box[0] + box[2]) / 2, (box[1] + box[3]) / 2), name, fill=INK, font=font, anchor="mm")


def place_labels(at: Mapping[str, Pixel], width_px: Mapping[str, float], taken: Sequence[Box]) -> dict[str, Box]:
    """A box for each name near its point, in the picture, and clear of others and of `taken` where there is room."""
    boxes: dict[str, Box] = {}
    for name, (x, y) in sorted(at.items(), key=lambda item: item[1][1]):
        half_px = width_px[name] / 2 + GAP_PX
        sides = itertools.product(_AWAY_PX, _SIDES)
        middles = [(x + dx * (half_px + away), y + dy * (LABEL_PX + away)) for away, (dx, dy) in sides]
        tries = [(cx - half_px, cy - LABEL_PX, cx + half_px, cy + LABEL_PX) for cx, cy in middles]
        inside = [box for box in tries if min(box[:2]) >= 0 and box[2] < WIDTH and box[3] < HEIGHT] or tries
        free = (box for box in inside if not _covers(box, [*taken, *boxes.values()]))
        apart = (box for box in inside if not _covers(box, [*boxes.values()]))
        boxes[name] = next(free, None) or next(apart, inside[0])
    return boxes


def _square(at: Pixel) -> Box:
    return (at[0] - 12, at[1] - 12, at[0] + 12, at[1] + 12)


def _covers(box: Box, others: Sequence[Box]) -> bool:
    return any(box[0] < far[2] and far[0] < box[2] and box[1] < far[3] and far[1] < box[3] for far in others)


def _extend(image: Image.Image, lines: Sequence[str]) -> Image.Image:
    """The picture above its text."""
    shown = [shorten(line, LETTERS, placeholder=" ...") for line in lines[:MOST_LINES]]
    shown += [f"... and {len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else []
    page = Image.new("RGB", (WIDTH, HEIGHT + LINE_PX * (len(shown) + 1) * bool(shown)), PAPER[:3])
    page.paste(image)
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(FONT_PX)
    draw.multiline_text(
        (MARGIN_PX, HEIGHT + MARGIN_PX), "\n".join(shown), fill=INK, font=font, spacing=LINE_PX - FONT_PX
    )
    return page
