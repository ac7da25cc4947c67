"""Pictures of a session at any moment: the true world, paths of the tool, and outlines of objects as believed.

MUJOCO_GL selects the graphics when MuJoCo is imported.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw

from phyagentos.errors import DefinitionError
from phyagentos.pictures.outlines import iter_outlines
from phyagentos.pictures.playback import Array, Playback
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.world.environment import Environment

Picture = NDArray[np.uint8]
MEASURED, PLANNED, BELIEVED = (0.10, 0.35, 0.85, 1.0), (0.95, 0.55, 0.05, 1.0), (0.75, 0.1, 0.85, 1.0)
PATH_RADIUS_M, PATH_POINTS = 0.003, 150
SHADOW_PX = 1024  # more of it is most of the time of a picture
AZIMUTH_DEG, ELEVATION_DEG, DISTANCE_M = 180.0, -40.0, 1.6


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """How a moment is shown.

    Attributes:
        camera: A camera of the model; empty for a view of the table from the front.
        paths: Whether to draw the tool's paths: measured up to the moment, and as commanded.
        beliefs: Whether to draw movable objects where they are believed to be.
    """

    camera: str = ""
    width: int = 800
    height: int = 600
    paths: bool = True
    beliefs: bool = True


class SceneRenderer:
    """Draws moments of one session; a context manager.

    Raises:
        DefinitionError: `UNKNOWN_NAME`; `NO_GRAPHICS` when this machine cannot draw.
    """

    def __init__(self, playback: Playback, look: Look) -> None:
        self._playback, self._look = playback, look
        model, where = playback.model, str(playback.bundle.folder)
        model.vis.quality.shadowsize = SHADOW_PX
        self._renderer = open_renderer(model, look.camera, look.width, look.height, where)
        self._data = mujoco.MjData(model)

    def __enter__(self) -> "SceneRenderer":
        return self

    def __exit__(self, *_: object) -> None:
        self._renderer.close()

    def draw(self, time_s: float) -> Picture:
        """(height, width, 3) the moment, with a caption: session, time, active leaf."""
        playback, look, scene = self._playback, self._look, self._renderer.scene
        self._renderer.update_scene(playback.pose(time_s, self._data), look.camera or self._make_camera())
        if look.paths:
            done = int(np.searchsorted(playback.time_s, time_s)) / len(playback.time_s)
            _add_path(scene, playback.planned_m, PLANNED)
            _add_path(scene, playback.measured_m[: max(2, round(done * len(playback.measured_m)))], MEASURED)
        believed = playback.believe(time_s)
        if look.beliefs and believed is not None:
            _add_believed(scene, believed)
        return _write_caption(self._renderer.render(), self._describe(time_s), look)

    def _make_camera(self) -> mujoco.MjvCamera:
        camera = mujoco.MjvCamera()
        places = self._playback.measured_m
        camera.lookat[:] = (places.min(axis=0) + places.max(axis=0)) / 2 if len(places) else (0.4, 0.0, 0.1)
        camera.azimuth, camera.elevation, camera.distance = AZIMUTH_DEG, ELEVATION_DEG, DISTANCE_M
        return camera

    def _describe(self, time_s: float) -> str:
        bundle = self._playback.bundle
        leaf = next((each.path for each in reversed(bundle.trace) if each.role and each.time_s <= time_s), "")
        return f"{bundle.session.id}   {time_s - self._playback.time_s[0]:5.2f} s   {leaf}"


def open_renderer(model: mujoco.MjModel, camera: str, width: int, height: int, where: str) -> mujoco.Renderer:
    """What draws a model, by the camera that is named, if any; raises as `SceneRenderer`, about `where`."""
    cameras = [model.camera(index).name for index in range(model.ncam)]
    if camera and camera not in cameras:
        raise DefinitionError.unknown("camera", "--camera", camera, cameras)
    model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
    model.vis.global_.offheight = max(model.vis.global_.offheight, height)
    try:
        return mujoco.Renderer(model, height, width)
    except Exception as error:  # graphics drivers raise what they like
        found = f"{type(error).__name__}: {error}"
        raise DefinitionError.of("NO_GRAPHICS", where, found, "MuJoCo's graphics", "See `paos doctor`.") from error


def iter_film(playback: Playback, look: Look, *, fps: int, speed: float = 1.0) -> Iterator[Picture]:
    """The pictures of a film of the whole session, at `speed` times the robot's own."""
    first_s, last_s = playback.time_s[0], playback.time_s[-1]
    with SceneRenderer(playback, look) as renderer:
        for index in range(round((last_s - first_s) * fps / speed) + 1):
            yield renderer.draw(min(last_s, first_s + index * speed / fps))


def write_film(pictures: Iterator[Picture], to: Path, fps: int) -> None:
    """An animated WebP, or a GIF, by the suffix of the file."""
    first, *rest = (Image.fromarray(each) for each in pictures)
    form: Fields = {"quality": 60, "method": 4} if to.suffix == ".webp" else {"optimize": True}
    first.save(to, save_all=True, append_images=rest, duration=round(1000 / fps), loop=0, **form)


def _add_path(scene: mujoco.MjvScene, places: Array, rgba: tuple[float, ...]) -> None:
    some = places[np.linspace(0, len(places) - 1, min(len(places), PATH_POINTS)).astype(int)] if len(places) else places
    for before, after in pairwise(some):
        geom = add_geom(scene, mujoco.mjtGeom.mjGEOM_CAPSULE, np.zeros(3), np.zeros(3), np.eye(3), rgba)
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, PATH_RADIUS_M, before, after)


def _add_believed(scene: mujoco.MjvScene, believed: Environment) -> None:
    for outline in iter_outlines(believed):
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, np.array(outline.quaternion_wxyz))
        add_geom(scene, mujoco.mjtGeom.mjGEOM_LINEBOX, outline.half_m, outline.position_m, turn, BELIEVED)


def add_geom(scene: mujoco.MjvScene, kind: int, size: Array, at: Array, turn: Array, rgba: ArrayLike) -> mujoco.MjvGeom:
    """One more shape of a scene that is about to be drawn."""
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(geom, kind, size, at, turn.ravel(), np.array(rgba, np.float32))
    scene.ngeom += 1
    return geom


def _write_caption(picture: Picture, text: str, look: Look) -> Picture:
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image, "RGBA")
    draw.rectangle((0, look.height - 22, look.width, look.height), fill=(20, 24, 28, 190))
    draw.text((8, look.height - 18), text, fill=(255, 255, 255))
    legend = [("measured", MEASURED), ("planned", PLANNED)] if look.paths else []
    legend += [("believed", BELIEVED)] if look.beliefs else []
    for place, (word, rgba) in enumerate(legend):
        left = look.width - 84 * (len(legend) - place)
        draw.rectangle(
            (left, look.height - 15, left + 9, look.height - 7), fill=tuple(int(255 * each) for each in rgba[:3])
        )
        draw.text((left + 13, look.height - 18), word, fill=(255, 255, 255))
    return np.asarray(image)
