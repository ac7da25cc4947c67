"""Several workspaces behind one address: the list of runs, grids of suites, and the page of each workspace as opened.

`w/WORKSPACE/` is the page of a workspace, `e/SUITE/EPISODE/` that of an episode. Names in addresses are looked up in
the table of what was found; no path is made of them.
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from threading import Event

from fastapi import FastAPI, Request, Response
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send

from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, ExecutionError, get_known
from phyagentos.operations.fleet import FleetWatch
from phyagentos.protocol.documents.plain_data import Fields
from phyagentos.view.access import Access
from phyagentos.view.documents import Documents
from phyagentos.view.fleet_page import add_fleet
from phyagentos.view.overview import read_overview
from phyagentos.view.places import Place, find_places
from phyagentos.view.scenes import PATH
from phyagentos.view.server import add_runs, answer, build_app, make_guarded
from phyagentos.view.suites import find_episode, read_grid

FRESH_S = 1.0  # a list that was read serves all viewers for so long
PAGES_KEPT = 32  # workspaces that stay open
_NAMES = {"w": 1, "e": 2}  # parts of an address behind its first one that name a workspace


def open_places(
    given: Sequence[Path],
    ends: Event,
    *,
    allows_actions: bool = False,
    runs: Mapping[str, Path] | None = None,
    fleet: FleetWatch | None = None,
) -> Callable[[Access], ASGIApp]:
    """What builds the application: the page of one workspace with one goal at most, else a list in front of all.

    Raises:
        DefinitionError: `NOT_A_WORKSPACE` where nothing is found in one of the folders; `LEADS_OUT`.
        ExecutionError: `JOURNAL_DAMAGED`.
    """
    opened = []
    for each in given:
        first = next(iter(find_places([each]).values()), None)
        if first is None or (first.root == each.resolve() and not first.is_suite):
            opened.append(Documents(each))
            opened[-1].refresh()
    if len(opened) == len(given) == 1 and len(opened[0].ledger.goals) <= 1:

        def build(access: Access) -> FastAPI:
            app = build_app(
                opened[0], access, allows_actions=allows_actions, runs=runs, ends=ends, has_fleet=fleet is not None
            )
            add_fleet(app, fleet, access, allows_actions=allows_actions)
            return app

        return build
    return lambda access: Site(given, access, ends, allows_actions=allows_actions, runs=runs or {}, fleet=fleet)


class Site:
    """The application of the folders that were `given`, read anew whenever the list is."""

    def __init__(
        self,
        given: Sequence[Path],
        access: Access,
        ends: Event,
        *,
        allows_actions: bool,
        runs: Mapping[str, Path],
        fleet: FleetWatch | None = None,
    ) -> None:
        self._given, self._access, self._runs = tuple(given), access, runs
        self._build = partial(build_app, allows_actions=allows_actions, ends=ends)
        self._pages: dict[tuple[str, ...], FastAPI] = {}
        self._front = self._build_front(has_fleet=fleet is not None)
        add_fleet(self._front, fleet, access, allows_actions=allows_actions)
        self._front.add_api_route("/{name:path}", refuse)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, by the list or by the page of a workspace."""
        app: ASGIApp = self._front
        try:
            app, scope = await self._choose(scope)
        except (DefinitionError, ExecutionError, OSError, ValueError, LookupError) as error:
            scope["problem"] = error
        await app(scope, receive, send)

    async def _choose(self, scope: Scope) -> tuple[ASGIApp, Scope]:
        """Who answers, and with which address; nothing is opened for a request without its token."""
        connection, path = HTTPConnection(scope), scope["path"]
        if path.startswith(PATH):
            scene, _, rest = path.removeprefix(PATH).partition("/")
            name = tuple(scene.split("~")[: _NAMES[scene.partition("~")[0]] + 1])
            is_ours = self._access.admits_scene(connection.headers, scene, rest.partition("/")[0])
        else:
            key, _, rest = path[1:].partition("/")
            is_keyed = key == self._access.page_key
            parts = (rest if is_keyed else path[1:]).split("/")
            length = _NAMES[parts[0]] + 1
            name, path = tuple(parts[:length]), "/".join(("", *[key] * is_keyed, *parts[length:]))
            is_ours = len(parts) > length and self._access.admits(connection.headers, connection.cookies, key)
        return (await self._open(name), {**scope, "path": path}) if is_ours else (self._front, scope)

    async def _open(self, name: tuple[str, ...]) -> FastAPI:
        if name not in self._pages:
            documents = await asyncio.to_thread(lambda: Documents(self._find_root(name)))
            await asyncio.to_thread(documents.refresh)
            home, title = ("../../", "") if name[0] == "w" else (f"../../../suites/{name[1]}/", name[2])
            app = self._build(documents, replace(self._access, place="~".join((*name, ""))), home=home, title=title)
            self._pages = dict([*self._pages.items()][1 - PAGES_KEPT :]) | {name: app}
        return self._pages[name]

    def _find_root(self, name: tuple[str, ...]) -> Path:
        """Raises DefinitionError `UNKNOWN_NAME`, OSError."""
        _, key, *episode = name
        place = self._find_place(key, is_suite=bool(episode))
        return find_episode(place, episode[0]) if episode else place.root

    def _find_place(self, key: str, *, is_suite: bool) -> Place:
        known = {name: each for name, each in find_places(self._given).items() if each.is_suite == is_suite}
        return get_known("run" if is_suite else "workspace", "paos view", key, known)

    def _find_suites(self) -> list[Place]:
        return [each for each in find_places(self._given).values() if each.is_suite]

    def _build_front(self, *, has_fleet: bool) -> FastAPI:
        app, clock = make_guarded(self._access), SystemClock()
        (only, *others) = find_places(self._given).values()

        @lru_cache(maxsize=8)
        def read(page: int, _: int) -> Fields:
            return read_overview(self._given, page) | {"has_fleet": has_fleet}

        @app.get("/")
        def show_list(page: int = 1) -> Response:
            if only.is_suite and not others:
                return answer("grid", lambda: read_grid(only) | {"others": []})
            return answer("overview", lambda: read(max(1, page), int(clock.now_s() / FRESH_S)))

        add_runs(app, lambda: {each.key: each.root for each in self._find_suites()} | dict(self._runs))

        @app.get("/suites/{key}/")
        def show_grid(key: str) -> Response:
            place = self._find_place(key, is_suite=True)
            others = [each for each in self._find_suites() if each != place]
            return answer("grid", lambda: read_grid(place) | {"others": others}, "../../")

        return app


def refuse(request: Request, name: str) -> Response:
    """What no page is called."""
    raise request.scope.get("problem", LookupError(f"no page {name!r}"))
