"""The 3D scene of a session, live and in replay: viser with mjviser, one scene a viewer, behind the page's token.

A running session shows its robot as its heartbeat says, and objects where they were believed to be before. One that has
ended shows the moment of its evidence at which the cursor of the page stands. The page posts it to the frame of the
scene, with what else a person has chosen (`Control`), and the frame sends it on.
"""

import asyncio
import contextlib
import io
import math
import secrets
import tempfile
import threading
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from fastapi import FastAPI, Request, WebSocket, WebSocketDisconnect
from fastapi.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from PIL import Image, ImageDraw
from websockets.asyncio.client import unix_connect

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.pictures.outlines import iter_outlines
from phyagentos.protocol.capabilities.registries import read_target_registry
from phyagentos.protocol.documents.packed_files import check_picture
from phyagentos.protocol.sessions.evidence import INITIAL, SCENE_MODEL, Bundle
from phyagentos.protocol.sessions.looks import read_picture
from phyagentos.protocol.sessions.session import SessionId
from phyagentos.protocol.workspace.array_files import read_arrays
from phyagentos.protocol.world.environment import Entity, Environment, Status
from phyagentos.view.access import Access
from phyagentos.view.documents import Documents
from phyagentos.view.frames import SeenFrame, read_frames

PATH = "/scene/"
STEP_S = 0.05  # between two looks at what a scene shows: heartbeats come ten times a second
RETRY_S = 1.0  # before evidence that could not be read is read again
_MEASURED, _PLANNED, _BELIEVED, _DOUBTED = (26, 90, 217), (242, 140, 13), (190, 26, 217), (217, 26, 26)

_POLICY = (
    "default-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' data: blob:; "
    "connect-src 'self' data: blob: {sockets}; "
    "form-action 'none'; base-uri 'none'; frame-ancestors {pages}"
)
CONTROL_MAX = 1024  # bytes of what a frame sends
_SHIM = """<style>
[data-floating-window], [title="About Viser"], .mantine-Notifications-root, .mantine-Paper-root { visibility: hidden; }
</style>
<script>document.hasFocus = () => !document.hidden;  // it looks for its server only in the focus
let wanted = {}, changed = false, busy = false, isFed = false, graphics = null;
const open = HTMLCanvasElement.prototype.getContext, pause = ms => new Promise(done => setTimeout(done, ms));
HTMLCanvasElement.prototype.getContext = function (...how) {
  const made = open.apply(this, how);
  if (made?.fenceSync) graphics = made;
  return made;
};
const report = async () => {  // to the page, once the commands that draw the first moment are carried out
  while (!graphics) await pause(200);
  await pause(1000);
  const fence = graphics.fenceSync(graphics.SYNC_GPU_COMMANDS_COMPLETE, 0);
  graphics.flush();
  while (graphics.getSyncParameter(fence, graphics.SYNC_STATUS) !== graphics.SIGNALED) await pause(100);
  parent.postMessage("drawn", "*");
};
const send = async () => {
  if (busy || !changed) return;
  busy = true;
  changed = false;
  const body = JSON.stringify(wanted);
  const is_sent = await fetch("control", {method: "POST", body}).then(each => each.ok, () => false);
  busy = false;
  if (is_sent && !isFed) { isFed = true; report(); }
  if (!is_sent) { changed = true; setTimeout(send, 300); } else send();
};
addEventListener("message", event => {
  if (event.source !== parent || typeof event.data !== "object") return;
  wanted = {...wanted, ...event.data};
  changed = true;
  send();
});</script>"""
_LOOK_AT_M = (0.3, 0.0, 0.15)
LABEL = 0.8  # of viser's own size
AMBIENT = 1.0  # light from everywhere, beside viser's own lamps
_building = threading.Lock()
STAGES: "dict[str, Stage]" = {}  # those that are fed, by the random names of their viewers


class Control(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a viewer has chosen: a moment in the target's time [s], and what is drawn beside the world."""

    time_s: float | None = None
    paths: bool = True
    believed: bool = True
    cameras: bool = False
    dark: bool = False


def add_scenes(app: FastAPI, documents: Documents, access: Access) -> None:
    """The pages `/scene/SESSION/KEY/VIEWER/`, and the sockets over which their scenes come.

    The client of viser needs `eval`, and shows texts of documents: it comes from another port, hence from an origin
    of its own, which reads nothing of the page and knows the key of one session's scene alone.
    """
    sockets, pages = (
        " ".join(f"{scheme}://{name}" for name in sorted(names))
        for scheme, names in (("ws", access.scene_hosts), ("http", access.hosts))
    )
    policy = {"content-security-policy": _POLICY.format(sockets=sockets, pages=pages)}

    @app.get(PATH + "{session}/{key}/")
    def begin(request: Request, session: str, key: str) -> Response:
        if not access.admits_scene(request.headers, session, key):
            return PlainTextResponse("no such scene\n", 401)
        return RedirectResponse(f"{secrets.token_urlsafe(9)}/", 303)

    @app.post(PATH + "{session}/{key}/{viewer}/control")
    async def control(request: Request, session: str, key: str, viewer: str) -> Response:
        if not access.admits_scene(request.headers, session, key) or not access.is_scene_origin(request.headers):
            return PlainTextResponse("no such scene\n", 401)
        data = b""
        async for part in request.stream():
            data = (data + part)[:CONTROL_MAX]
        try:
            STAGES[viewer].control = msgspec.json.decode(data, type=Control)
        except (KeyError, msgspec.MsgspecError):  # it is not fed yet
            return PlainTextResponse("no such scene, or nothing to choose\n", 404)
        return Response(status_code=204)

    @app.get(PATH + "{session}/{key}/{viewer}/")
    def show_client(request: Request, session: str, key: str) -> Response:
        if not access.admits_scene(request.headers, session, key):
            return PlainTextResponse("no such scene\n", 401)
        if SessionId(session.removeprefix(access.place)) not in documents.ledger.sessions:
            return PlainTextResponse(f"no session {session!r}\n", 404)
        return HTMLResponse(_read_client(), headers=policy)

    _add_sockets(app, documents, access)


def _add_sockets(app: FastAPI, documents: Documents, access: Access) -> None:
    @app.websocket(PATH + "{session}/{key}/{viewer}")
    async def connect(socket: WebSocket, session: str, key: str, viewer: str) -> None:
        if not access.admits_scene(socket.headers, session, key) or not access.is_scene_origin(socket.headers):
            await socket.close(1008)
            return
        wanted = [each.strip() for each in socket.headers.get("sec-websocket-protocol", "").split(",") if each.strip()]
        await socket.accept(wanted[0] if wanted else None)  # at once: the client gives up after five seconds
        try:
            stage = await asyncio.to_thread(Stage, documents, SessionId(session.removeprefix(access.place)))
        except (DefinitionError, ExecutionError, KeyError, OSError, ValueError) as error:
            await socket.close(1011, str(error)[:100])
            return
        except asyncio.CancelledError:  # the server ends while the scene is made
            return
        STAGES[viewer] = stage
        try:
            await _relay(socket, stage.socket, wanted)
        finally:
            STAGES.pop(viewer, None)
            await asyncio.to_thread(stage.close)


async def _relay(socket: WebSocket, path: Path, protocols: list[Any]) -> None:
    """Pass messages on between a viewer and its scene, until either hangs up."""
    scene = unix_connect(str(path), "ws://localhost/", subprotocols=protocols, max_size=None, compression=None)
    async with scene as behind:

        async def pass_in() -> None:
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):
                while True:
                    await behind.send(await socket.receive_bytes())

        async def pass_out() -> None:
            async for message in behind:
                await socket.send_bytes(message if isinstance(message, bytes) else message.encode())

        tasks = {asyncio.create_task(pass_in()), asyncio.create_task(pass_out())}
        _, others = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in others:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


class Stage:
    """The scene of one session for one viewer, on a socket that only this user can open.

    Raises:
        DefinitionError, ExecutionError, OSError, ValueError: The evidence holds no scene, or a damaged one.
    """

    def __init__(self, documents: Documents, session: SessionId) -> None:
        import mujoco
        from mjviser import ViserMujocoScene

        from phyagentos.pictures.model_file import read_model

        self._documents, self._session = documents, session
        status = documents.ledger.sessions[session]
        folder = documents.workspace.evidence_of(session)
        self._model = read_model(folder / SCENE_MODEL)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = read_arrays(folder / INITIAL)["qpos"]
        known, own = read_target_registry(documents.workspace.target_registry), status.contract.target
        self._robots = {
            name: each for name, each in known.items() if name == own or (each.world and each.world == known[own].world)
        }
        self._folder = tempfile.TemporaryDirectory(prefix="paos-scene-")
        self.socket = Path(self._folder.name) / "scene"
        self._server = _start_server(self.socket)
        self._is_dark = False
        self._choose_theme()
        self._scene = ViserMujocoScene(self._server, self._model, num_envs=1)
        self._scene.camera_tracking_enabled = False
        self._light()
        self._aim()
        self.control = Control()
        self._playback: Any = None
        self._replayed: Control | None = None  # what was chosen for the moment that stands there
        self._paths: list[Any] = []
        self._told = ""
        self._shown: tuple[object, ...] = ()  # joint positions
        self._believed: tuple[object, ...] = ()  # revision and age of what is outlined
        self._outlines: list[Any] = []
        self._cameras = Cameras(self._server)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"scene-{session}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the scene."""
        self._ended.set()
        self._thread.join()
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()
        self._folder.cleanup()

    def _light(self) -> None:
        """Flat light: a map of surroundings and shadows take four fifths of the time of a browser without graphics."""
        scene = self._server.scene
        scene.configure_environment_map(None)
        scene.configure_default_lights(cast_shadow=False)
        scene.add_light_ambient("/light", intensity=AMBIENT)

    def _aim(self) -> None:
        """Look from where the first camera of the model does, which pictures for people are drawn by."""
        import mujoco

        position, look_at, camera = np.array((1.6, 0.0, 1.1)), np.array(_LOOK_AT_M), self._server.initial_camera
        camera.fov = 0.85
        if self._model.ncam:
            mujoco.mj_forward(self._model, self._data)
            position, forward = self._data.cam_xpos[0], -self._data.cam_xmat[0].reshape(3, 3)[:, 2]
            look_at = position + max(0.5, float(forward @ (look_at - position))) * forward
            camera.fov = math.radians(self._model.cam_fovy[0])
        camera.position, camera.look_at = position, look_at

    def _choose_theme(self) -> None:
        self._server.gui.configure_theme(
            control_width="small", show_logo=False, show_share_button=False, dark_mode=self._is_dark
        )

    def _run(self) -> None:
        while not self._ended.wait(STEP_S):
            status = self._documents.ledger.sessions[self._session]
            try:
                if status.execution is None:
                    self._follow()
                elif self._playback is None:
                    self._begin_replay()
                else:
                    self._replay()
            except (ExecutionError, OSError) as error:  # thinned, damaged, or still being written
                self._tell(str(error))
                self._ended.wait(RETRY_S)

    def _tell(self, problem: str) -> None:
        """Say once what is wrong."""
        if problem != self._told:
            self._told = problem
            self._server.scene.add_label("/problem", problem, position=_LOOK_AT_M)  # never as markup

    def _follow(self) -> None:
        """Show what the heartbeats say."""
        from phyagentos.pictures.playback import follow_beats

        status, beats = self._documents.ledger.sessions[self._session], self._documents.read_beats()
        follow_beats(self._model, self._data, self._robots, beats)
        beat = beats.get(status.contract.target)
        self._show(self._documents.read_bundle(status).before, beat.sim_time_s if beat is not None else 0.0)

    def _begin_replay(self) -> None:
        """Read the evidence, and draw the paths of the tool."""
        from phyagentos.pictures.playback import read_playback

        status = self._documents.ledger.sessions[self._session]
        playback = self._playback = read_playback(self._documents.workspace, status)
        for name, places, color in (
            ("measured", playback.measured_m, _MEASURED),
            ("planned", playback.planned_m, _PLANNED),
        ):
            if len(places) > 1:
                segments = np.stack((places[:-1], places[1:]), axis=1)
                path = self._server.scene.add_line_segments(
                    f"/paths/{name}", segments, np.array(color), thickness=0.004
                )
                self._paths.append(path)

    def _replay(self) -> None:
        control, (first_s, *_, last_s) = self.control, self._playback.time_s
        if control is self._replayed:
            return
        time_s = float(np.clip(first_s if control.time_s is None else control.time_s, first_s, last_s))
        for each in self._paths:
            each.visible = control.paths
        self._playback.pose(time_s, self._data)
        self._show(self._playback.believe(time_s), time_s)
        self._replayed = control

    def _show(self, believed: Environment | None, time_s: float) -> None:
        import mujoco

        if (joints := tuple(self._data.qpos)) != self._shown:
            self._shown = joints
            mujoco.mj_forward(self._model, self._data)
            self._scene.update_from_mjdata(self._data)
        status, control = self._documents.ledger.sessions[self._session], self.control
        if control.dark != self._is_dark:
            self._is_dark = control.dark
            self._choose_theme()
        self._cameras.show(self._documents.read_bundle(status), time_s, is_wanted=control.cameras)
        if believed is not None and (key := (believed.revision, round(time_s), control.believed)) != self._believed:
            self._believed = key
            self._show_believed(believed, time_s)

    def _show_believed(self, believed: Environment, time_s: float) -> None:
        """Outlines of movable objects with their names; uncertain ones are red, with their age and confidence."""
        scene, before = self._server.scene, self._outlines
        outlines = list(iter_outlines(believed)) if self.control.believed else []
        with self._server.atomic():
            for each in before:
                each.remove()
            self._outlines = [
                scene.add_box(
                    f"/believed/{index}",
                    color=_DOUBTED if _is_doubtful(each.entity) else _BELIEVED,
                    dimensions=2.0 * each.half_m,
                    wireframe=True,
                    wxyz=each.quaternion_wxyz,
                    position=each.position_m,
                )
                for index, each in enumerate(outlines)
            ]
            named = {each.entity.name: each.entity for each in outlines}
            across = sorted(named.items(), key=lambda each: each[1].pose.position_m[1])
            for index, (name, entity) in enumerate(across):
                age_s, text = max(0.0, time_s - entity.observed_at_s), name
                if _is_doubtful(entity):
                    text += f": {entity.status}, {age_s:.0f} s old, {100 * entity.confidence:.0f} %"
                position = np.add(entity.pose.position_m, (0, 0, 0.06 + 0.05 * (index % 2)))  # neighbours stand free
                label = scene.add_label(f"/named/{index}", text, position=position, font_screen_scale=LABEL)
                self._outlines.append(label)


def _is_doubtful(entity: Entity) -> bool:
    return entity.is_unsure or entity.status is Status.HIDDEN


class Cameras:
    """What each camera saw last, with the windows of objects, where the camera was."""

    def __init__(self, server: Any) -> None:
        self._scene = server.scene
        self._bundle: Bundle | None = None
        self._frames: list[SeenFrame] = []
        self._shown: list[SeenFrame] = []
        self._handles: list[Any] = []

    def show(self, bundle: Bundle, time_s: float, *, is_wanted: bool) -> None:
        """The latest picture of each camera until then, of those that perception has used; none, unless wanted."""
        if is_wanted and bundle is not self._bundle:
            self._frames, self._bundle = sorted(read_frames(bundle), key=lambda each: each.frame.time_s), bundle
        frames = self._frames if is_wanted else []
        latest = list({each.frame.camera: each for each in frames if each.frame.time_s <= time_s}.values())
        if latest == self._shown:
            return
        for handle in self._handles:
            handle.remove()
        self._shown, self._handles = latest, []
        self._handles += [self._add(bundle.folder, index, each) for index, each in enumerate(latest)]

    def _add(self, folder: Path, index: int, shown: SeenFrame) -> Any:
        frame, pose = shown.frame, shown.frame.world_T_camera
        image = Image.open(io.BytesIO(check_picture(read_picture(folder / shown.look.file, frame.rgb)))).convert("RGB")
        for left, top, width, height in shown.seen.values():
            ImageDraw.Draw(image).rectangle((left, top, left + width, top + height), outline=_BELIEVED)
        return self._scene.add_camera_frustum(
            f"/cameras/{index}",
            fov=2.0 * math.atan2(frame.height, 2.0 * frame.fy),
            aspect=image.width / image.height,
            scale=0.12,
            thickness=0.003,
            cast_shadow=False,
            image=np.asarray(image),
            wxyz=pose.quaternion_wxyz,
            position=pose.position_m,
        )


def _start_server(path: Path) -> Any:
    """A server of viser that listens on a socket of the file system, and on no port, which any user could open."""
    import viser
    import websockets.asyncio.server

    server: Any = websockets.asyncio.server

    def serve(handler: Any, _host: str, _port: int, **settings: Any) -> Any:
        return server_class(handler, unix=True, path=str(path), **settings)

    with _building, contextlib.redirect_stdout(io.StringIO()):
        server_class = server.serve
        server.serve = serve  # viser knows of ports only
        try:
            made = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
        finally:
            server.serve = server_class
    if not path.is_socket():
        made.stop()
        raise OSError(f"the server of the scene does not listen on {path}")
    return made


@cache
def _read_client() -> str:
    """The client of viser: one file that asks for nothing else."""
    import viser

    client = Path(viser.__file__).with_name("client") / "build" / "index.html"
    return client.read_text(encoding="utf-8").replace("<head>", f"<head>{_SHIM}", 1)
