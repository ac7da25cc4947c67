"""The server of the page: pages, panels as they change, files of the evidence, actions where they are allowed."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import suppress
from pathlib import Path
from threading import Event
from urllib.parse import parse_qsl, quote

from fastapi import FastAPI, Request, Response
from fastapi.responses import FileResponse, HTMLResponse, PlainTextResponse, RedirectResponse, StreamingResponse
from fastapi.staticfiles import StaticFiles
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from phyagentos.errors import DefinitionError, ExecutionError
from phyagentos.pictures.layers import STYLE
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.protocol.sessions.looks import read_picture
from phyagentos.view import actions, comparison, scenes
from phyagentos.view.access import Access, hash_source
from phyagentos.view.documents import Documents, Version
from phyagentos.view.film import add_film
from phyagentos.view.pages import PanelRenderer, render
from phyagentos.view.panels import PANELS, Place, Query

LOOK_PERIOD_S = 0.4  # between two looks at the documents
PULSE_PERIOD_S = 0.05  # between two looks at the heartbeats, which are written ten times a second
SILENCE_S = 10.0  # after so long a stream says that it lives
_STATIC = Path(__file__).with_name("static")
FORM_MAX = 1 << 20  # bytes of what a form sends
_ENTER = (  # where an address lacks the key of the page, its own tab still knows that
    'const base = sessionStorage.getItem("paos");'
    "if (base && !location.pathname.startsWith(base))"
    " location.replace(base + location.pathname.slice(1) + location.search);"
)
_REFUSAL = "Open the address that `paos view` has printed: it carries the token."
_POLICY = (
    f"default-src 'self'; style-src 'self' {hash_source(STYLE)}; script-src 'self' {hash_source(_ENTER)}; "
    "img-src 'self' data:; object-src 'none'; frame-ancestors 'self'; form-action 'self'; base-uri 'none'"
)
_MEDIA = {".png": "image/png"} | dict.fromkeys(  # of files of evidence; whatever a browser could run is only saved
    (".json", ".jsonl", ".yaml", ".md", ".xml"), "text/plain; charset=utf-8"
)


class Watcher:
    """Looks at the documents while a stream waits, more often at heartbeats alone, and wakes all when either is new.

    Attributes:
        version: Of the documents.
        pulse: Of the heartbeats, as data: one event for all viewers, for which nothing is rendered.
        ends: All are woken once it is set.
    """

    def __init__(self, documents: Documents, ends: Event) -> None:
        self.version, self.pulse = Version(), ""
        self.ends = ends
        self._documents = documents
        self._news = asyncio.Event()
        self._waiting = 0
        self._tasks: dict[float, asyncio.Task[None]] = {}

    async def wait(self, seen: tuple[Version, str]) -> tuple[Version, str]:
        """Version and pulse once either is another one than `seen`; at the latest after some seconds."""
        self._waiting += 1
        for look, period_s in ((self._look, LOOK_PERIOD_S), (self._feel, PULSE_PERIOD_S)):
            if period_s not in self._tasks or self._tasks[period_s].done():
                self._tasks[period_s] = asyncio.create_task(self._repeat(look, period_s))
        try:
            if (self.version, self.pulse) == seen and not self.ends.is_set():
                with suppress(TimeoutError):
                    async with asyncio.timeout(SILENCE_S):
                        await self._news.wait()
            return self.version, self.pulse
        finally:
            self._waiting -= 1

    async def _look(self) -> None:
        self.version = await asyncio.to_thread(self._documents.refresh)

    async def _feel(self) -> None:  # a small file for each target: less work than a thread
        self.pulse = f"event: pulse\ndata: {self._documents.read_pulse()}\n\n"

    async def _repeat(self, look: Callable[[], Awaitable[None]], period_s: float) -> None:
        while self._waiting:
            before = self.version, self.pulse
            with suppress(ExecutionError, OSError):  # the page itself says what is wrong
                await look()
            if (self.version, self.pulse) != before or self.ends.is_set():
                self._news.set()
                self._news = asyncio.Event()
            await asyncio.sleep(period_s)


class PanelFeed:
    """The events of all panels, rendered once a version for all viewers of one choice."""

    def __init__(self, renderer: PanelRenderer) -> None:
        self._renderer = renderer
        self._latest: dict[Query, tuple[Version, asyncio.Task[dict[str, str]]]] = {}

    async def read(self, query: Query, version: Version) -> dict[str, str]:
        """Panel -> its server-sent event."""
        known, task = self._latest.get(query, (None, None))
        if task is None or known != version:
            task = asyncio.create_task(asyncio.to_thread(self._encode, query))
            current = {choice: entry for choice, entry in self._latest.items() if entry[0] == version}
            self._latest = current | {query: (version, task)}
        return await asyncio.shield(task)  # one viewer that leaves ends it for no other

    def _encode(self, query: Query) -> dict[str, str]:
        events = {}
        for panel in PANELS:
            lines = "".join(f"data: {line}\n" for line in self._renderer.render(panel, query).splitlines())
            events[panel.name] = f"event: {panel.name}\n{lines}\n"
        return events


def build_app(
    documents: Documents,
    access: Access,
    *,
    allows_actions: bool = False,
    runs: Mapping[str, Path] | None = None,
    ends: Event | None = None,
    home: str = "",
    title: str = "",
    has_fleet: bool = False,
) -> FastAPI:
    """The application of one workspace; `runs` are folders of suites that may be compared, by name.

    Streams end once the server `ends`. `home` is the list that the workspace stands in, relative to its page, `title`
    its name there.
    """
    names: Fields = {"home": home, "title": title, "has_fleet": has_fleet}
    extras: Fields = {"actions": allows_actions, "live": True, "scene_address": access.scene_address}
    renderer = PanelRenderer(documents, lambda: extras)
    app = make_guarded(access)
    _add_pages(app, renderer, access, Watcher(documents, ends or Event()), extras | names)
    _add_comparison(app, documents)
    add_runs(app, lambda: runs or {})
    _add_files(app, documents)
    scenes.add_scenes(app, documents, access)
    add_film(app, documents)
    if allows_actions:
        _add_actions(app, documents, access)
    return app


def make_guarded(access: Access) -> FastAPI:
    """An application that answers nothing without the token, with its styles and scripts."""
    app = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    app.add_middleware(Guard, access=access)
    app.mount("/static", StaticFiles(directory=_STATIC))
    return app


class Guard:
    """No answer without the token; the address that `paos view` prints becomes a cookie and an address with a key.

    It passes each part of a stream straight on: a middleware of functions would hand it through three tasks.
    """

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app, self._access = app, access
        scenes_of = " ".join(f"http://{host}" for host in sorted(access.scene_hosts))
        self._headers = {
            "x-content-type-options": "nosniff",
            "referrer-policy": "no-referrer",
            "cache-control": "no-store",
            "cross-origin-resource-policy": "same-origin",
        }
        self._policy = f"{_POLICY}; frame-src 'self' {scenes_of}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or pass it on."""
        if scope["type"] != "http":  # sockets of scenes have a key of their own
            await self._app(scope, receive, send)
            return
        has_begun = False

        async def send_guarded(message: Message) -> None:
            nonlocal has_begun
            if message["type"] == "http.response.start":
                has_begun, headers = True, MutableHeaders(scope=message)
                headers.setdefault("content-security-policy", self._policy)
                headers.update(self._headers)
            await send(message)

        answer: ASGIApp = self._admit(Request(scope)) or self._app
        try:
            await answer(scope, receive, send_guarded)
        except (DefinitionError, ExecutionError, OSError, ValueError, LookupError, TypeError) as error:
            if has_begun:
                raise
            await PlainTextResponse(f"this cannot be shown: {error}\n", 404)(scope, receive, send_guarded)

    def _admit(self, request: Request) -> Response | None:
        """None for a request that may pass, from here on without the key in its address."""
        access, path, given = self._access, request.scope["path"], request.query_params.get("token", "")
        is_host = request.headers.get("host", "") in access.hosts
        if given and access.is_token(given) and is_host:
            entered = RedirectResponse(f"/{access.page_key}{quote(path)}", 303)
            entered.set_cookie(access.cookie, access.cookie_secret, httponly=True, samesite="strict")
            return entered
        key, _, rest = path[1:].partition("/")
        if not path.startswith(scenes.PATH) and not access.admits(request.headers, request.cookies, key):
            way_back = f"<script>{_ENTER}</script>" if is_host else ""
            return HTMLResponse(f"<!doctype html><title>phyagentos</title><p>{_REFUSAL}</p>{way_back}", 401)
        if key == access.page_key:
            request.scope["path"] = f"/{rest}"
        return None


def _add_pages(app: FastAPI, renderer: PanelRenderer, access: Access, watcher: Watcher, extras: Fields) -> None:
    documents, feed = renderer.documents, PanelFeed(renderer)

    @app.get("/", response_class=HTMLResponse)
    def show_page(goal: str = "", session: str = "", find: str = "") -> str:
        documents.refresh()
        query = Query(goal=goal, session=session, find=find)
        status = documents.find_session(session, goal)
        shown = [(panel, renderer.render(panel, query)) for panel in PANELS]
        return render(
            "page",
            places={place.value: [each for each in shown if each[0].place is place] for place in Place},
            query=query,
            stream=query.link().replace("./", "events", 1),
            status=status,
            workspace=documents.workspace.root,
            secret=access.form_secret if extras["actions"] else "",
            **extras,
        )

    @app.get("/panels/{name}", response_class=HTMLResponse)
    def show_panel(name: str, goal: str = "", session: str = "", find: str = "") -> Response:
        panel = next((each for each in PANELS if each.name == name), None)
        if panel is None:
            return PlainTextResponse(f"no panel {name!r}; there are {', '.join(each.name for each in PANELS)}\n", 404)
        documents.refresh()
        return HTMLResponse(renderer.render(panel, Query(goal=goal, session=session, find=find)))

    @app.get("/events")
    async def follow(request: Request, goal: str = "", session: str = "", find: str = "") -> StreamingResponse:
        stream = iter_changes(request, feed, watcher, Query(goal=goal, session=session, find=find))
        return StreamingResponse(stream, media_type="text/event-stream")


def answer(template: str, read: Callable[[], Fields], up: str = "./") -> Response:
    """A page, or what is wrong with its documents."""
    try:
        return HTMLResponse(render(template, up=up, **read()))
    except (DefinitionError, ExecutionError, OSError, ValueError, LookupError, TypeError) as error:
        return HTMLResponse(render("page_problem", up=up, error=error), 404)


def _add_comparison(app: FastAPI, documents: Documents) -> None:
    @app.get("/compare")
    def show_sessions(first: str, second: str) -> Response:
        documents.refresh()
        return answer("compare", lambda: comparison.compare_sessions(documents, first, second))


def add_runs(app: FastAPI, read_runs: Callable[[], Mapping[str, Path]]) -> None:
    """The page on which two runs of suites stand side by side, by their names; without names the first and the last."""

    @app.get("/compare/runs")
    def show_runs(first: str = "", second: str = "") -> Response:
        runs = read_runs()
        names = [first or next(iter(runs), ""), second or next(reversed([*runs]), "")]
        return answer("runs", lambda: comparison.compare_runs(runs, *names), "../")


async def iter_changes(request: Request, feed: PanelFeed, watcher: Watcher, query: Query) -> AsyncIterator[str]:
    """Server-sent events: each panel when it changes, all of them at first; the heartbeats whenever one is new."""
    sent: dict[str, str] = {}
    version, pulse = Version(), ""
    while not watcher.ends.is_set():
        (before, felt), (version, pulse) = (version, pulse), await watcher.wait((version, pulse))
        if pulse != felt:
            yield pulse
        if version == before and pulse != felt:
            continue
        if await request.is_disconnected():
            return
        events = await feed.read(query, version)
        changed = [event for name, event in events.items() if sent.get(name) != event]
        sent = events
        yield ": alive\n\n" + "".join(changed)


def _add_files(app: FastAPI, documents: Documents) -> None:
    evidence = documents.workspace.evidence

    @app.get("/evidence/{session}/{name}")
    def show_file(session: str, name: str) -> Response:
        path = _find_file(evidence, session, name)
        if path is None:
            return PlainTextResponse(f"no file {name!r} in the evidence of {session!r}\n", 404)
        return FileResponse(path, media_type=_MEDIA.get(path.suffix, "application/octet-stream"))

    @app.get("/frames/{session}/{name}/{member}")
    def show_frame(session: str, name: str, member: str) -> Response:
        path = _find_file(evidence, session, name)
        if path is not None:
            with suppress(ExecutionError):
                return Response(read_picture(path, member), media_type="image/png")
        return PlainTextResponse(f"no picture {member!r} in {name!r} of {session!r}\n", 404)


def _find_file(evidence: Path, session: str, name: str) -> Path | None:
    """A file of a bundle; None for whatever leads elsewhere, and for what no file is called."""
    path = evidence / session / name
    with suppress(OSError, ValueError):
        is_within = path.parent.parent == evidence and path.resolve().is_relative_to(evidence.resolve())
        return path if is_within and {session, name}.isdisjoint({"..", "."}) and path.is_file() else None
    return None


def _add_actions(app: FastAPI, documents: Documents, access: Access) -> None:
    @app.post("/actions/{name}", response_class=HTMLResponse)
    async def act(name: str, request: Request) -> Response:
        if not access.permits_action(request.headers):
            return PlainTextResponse("refused: not from a form of this page\n", 403)
        data = b""
        async for part in request.stream():
            data += part
            if len(data) > FORM_MAX:
                return PlainTextResponse(f"refused: a form of more than {FORM_MAX} bytes\n", 413)
        form: Fields = dict(parse_qsl(data.decode(errors="replace"), keep_blank_values=True))
        try:
            if name == actions.STOP:  # waits for no thread
                done = actions.perform(documents.workspace, name, form)
            else:
                done = await asyncio.to_thread(actions.perform, documents.workspace, name, form)
        except (DefinitionError, ExecutionError, OSError) as error:
            return HTMLResponse(render("unreadable", error=error), 422)
        return HTMLResponse(render("done", done=done))
