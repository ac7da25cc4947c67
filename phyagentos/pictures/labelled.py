"""Pictures of a scene with the names of its objects, and with each place where an object is to be.

MUJOCO_GL selects the graphics when MuJoCo is imported.
"""

import io
import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from phyagentos.errors import DefinitionError
from phyagentos.geometry import Vector

WIDTH, HEIGHT, LINE_PX, MARGIN_PX, GAP_PX, FONT_PX = 1000, 720, 22, 12, 6, 15
AZIMUTH_DEG, ELEVATION_DEG, SPARE = 180.0, -42.0, 1.25
LEAST_RADIUS_M, TALL = 0.3, 0.3  # of what is looked at; height of an arrow, as a share of its length
GHOST_ALPHA, ARROW, PAPER, INK = 0.45, (255, 138, 0), (250, 250, 248, 235), (24, 28, 32)
MOST_LINES, LABEL_PX = 14, 11  # half the height of a label
_SIDES = ((0, -1), (0, 1), (1, 0), (-1, 0), (1, -1), (-1, -1), (1, 1), (-1, 1))
_AWAY_PX = (10, 24, 42, 64, 90, 120)

Pixel = tuple[float, float]
Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Move:
    """A body that goes to a place (3,) of its origin in the world [m], by the numbered line of the text."""

    name: str
    to_m: Vector
    number: int


@dataclass(frozen=True, slots=True)
class Drawing:
    """What a picture shows beside the scene: names of bodies, moves in their order, and lines of text below."""

    names: Collection[str] = ()
    moves: Sequence[Move] = ()
    lines: Sequence[str] = ()
    camera: str = ""


def draw_labelled(model: mujoco.MjModel, data: mujoco.MjData, drawing: Drawing) -> bytes:
    """PNG of a scene, from the front, or by the camera that is named.

    Raises:
        DefinitionError: `UNKNOWN_NAME` of a camera; `NO_GRAPHICS` where this machine cannot draw.
    """
    cameras = [model.camera(index).name for index in range(model.ncam)]
    if drawing.camera and drawing.camera not in cameras:
        raise DefinitionError.unknown("camera", "--camera", drawing.camera, cameras)
    model.vis.global_.offwidth, model.vis.global_.offheight = WIDTH, HEIGHT
    try:
        with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, drawing.camera or _aim(model, data, drawing))
            for move in drawing.moves:
                _add_ghost(renderer.scene, model, data, move)
            image, view = Image.fromarray(renderer.render()), _View.read(renderer.scene)
    except Exception as error:  # graphics drivers raise what they like
        found = f"{type(error).__name__}: {error}"
        raise DefinitionError.of(
            "NO_GRAPHICS", "the picture", found, "MuJoCo's graphics", "See `paos doctor`."
        ) from error
    _write(image, _locate(model, data, drawing, view), [*_iter_arcs(data, drawing, view)])
    buffer = io.BytesIO()
    _extend(image, drawing.lines).save(buffer, format="PNG")
    return buffer.getvalue()


@dataclass(frozen=True, slots=True)
class _View:
    """Where points of the world are in the picture."""

    position_m: NDArray[np.float64]
    forward: NDArray[np.float64]
    up: NDArray[np.float64]
    slope: float  # of the upper edge of the picture

    @classmethod
    def read(cls, scene: mujoco.MjvScene) -> "_View":
        left, right = scene.camera
        middle = (np.array(left.pos) + right.pos) / 2
        return cls(middle, np.array(left.forward), np.array(left.up), left.frustum_top / left.frustum_near)

    def project(self, point_m: NDArray[np.float64] | Vector) -> Pixel:
        """Pixel of a point (3,) of the world."""
        way_m = np.array(point_m) - self.position_m
        depth_m = max(float(way_m @ self.forward), 1e-3)
        x, y = (float(way_m @ axis) / depth_m / self.slope for axis in (np.cross(self.forward, self.up), self.up))
        return (WIDTH / 2 + x * HEIGHT / 2, HEIGHT / 2 - y * HEIGHT / 2)


def _aim(model: mujoco.MjModel, data: mujoco.MjData, drawing: Drawing) -> mujoco.MjvCamera:
    """A view from the front that holds every named body, and where each is to be."""
    points = np.array([*(data.body(name).xpos for name in drawing.names), *(move.to_m for move in drawing.moves)])
    points = points if len(points) else np.array([[0.4, 0.0, 0.1]])
    low_m, high_m = points.min(axis=0), points.max(axis=0)
    radius_m = max(LEAST_RADIUS_M, float(np.linalg.norm(high_m - low_m)) / 2)
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
        geom = scene.geoms[scene.ngeom]
        at_m, turn = data.geom_xpos[number] + shift_m, data.geom_xmat[number]
        mujoco.mjv_initGeom(geom, model.geom_type[number], model.geom_size[number], at_m, turn, rgba)
        scene.ngeom += 1


def _locate(model: mujoco.MjModel, data: mujoco.MjData, drawing: Drawing, view: _View) -> dict[str, Pixel]:
    """Where the middle of each named body is seen; what is out of the picture is left out."""
    at = {name: view.project(data.geom_xpos[int(model.body(name).geomadr[0])]) for name in drawing.names}
    return {name: (x, y) for name, (x, y) in at.items() if 0 <= x < WIDTH and 0 <= y < HEIGHT}


def _iter_arcs(data: mujoco.MjData, drawing: Drawing, view: _View) -> Iterator[tuple[int, list[Pixel]]]:
    """Number and course of each arrow: from where a body is, or where it was put before, over a bow."""
    last = {move.name: np.array(data.body(move.name).xpos) for move in drawing.moves}
    for move in drawing.moves:
        start_m, end_m = last[move.name], np.array(move.to_m)
        lift_m = np.array((0.0, 0.0, 0.04 + TALL * float(np.linalg.norm(end_m - start_m))))
        shares = np.linspace(0.0, 1.0, 33)
        yield (
            move.number,
            [view.project(start_m + t * (end_m - start_m) + 4 * t * (1 - t) * lift_m) for t in shares],
        )
        last[move.name] = end_m


def _write(image: Image.Image, at: dict[str, Pixel], arcs: list[tuple[int, list[Pixel]]]) -> None:
    """Arrows, their numbers, and names beside what they name."""
    draw, font = ImageDraw.Draw(image, "RGBA"), ImageFont.load_default(FONT_PX)
    taken = [_square(point) for point in (*at.values(), *(course[-1] for _, course in arcs))]
    for _, course in arcs:
        draw.line(course, fill=(*INK, 160), width=6, joint="curve")
        draw.line(course, fill=ARROW, width=3, joint="curve")
        (ax, ay), (bx, by) = course[-4], course[-1]
        turn = math.atan2(by - ay, bx - ax)
        wings = [(bx - 15 * math.cos(turn + side), by - 15 * math.sin(turn + side)) for side in (-0.45, 0.45)]
        draw.polygon([(bx, by), *wings], fill=ARROW, outline=INK)
    for number, course in arcs:
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
    if not lines:
        return image
    font = ImageFont.load_default(FONT_PX)
    shown = [*lines[:MOST_LINES], *([f"... and {len(lines) - MOST_LINES} more"] if len(lines) > MOST_LINES else [])]
    page = Image.new("RGB", (WIDTH, HEIGHT + LINE_PX * len(shown) + 2 * MARGIN_PX), PAPER[:3])
    page.paste(image)
    draw = ImageDraw.Draw(page)
    for row, line in enumerate(shown):
        draw.text((MARGIN_PX, HEIGHT + MARGIN_PX + LINE_PX * row), _shorten(draw, line, font), fill=INK, font=font)
    return page


def _shorten(draw: ImageDraw.ImageDraw, line: str, font: "ImageFont.FreeTypeFont | ImageFont.ImageFont") -> str:
    """A line up to the width of the picture."""
    cut = line
    while draw.textlength(cut if cut == line else f"{cut}...", font=font) > WIDTH - 2 * MARGIN_PX:
        cut = cut[:-1]
    return cut if cut == line else f"{cut}..."
