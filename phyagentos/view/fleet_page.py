"""The page over a whole fleet: its hosts, what is open, who holds it, and the emergency stop for all."""

import asyncio
import getpass
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from fastapi import FastAPI, Request, Response
from fastapi.responses import HTMLResponse, PlainTextResponse

from phyagentos.errors import ExecutionError
from phyagentos.operations.fleet import FleetWatch, stop_all
from phyagentos.view.access import Access
from phyagentos.view.actions import Done
from phyagentos.view.pages import render
from phyagentos.view.server import answer


def add_fleet(app: FastAPI, fleet: FleetWatch | None, access: Access, *, allows_actions: bool) -> None:
    """The page, where there is a fleet; it stops where actions are allowed."""
    if fleet is None:
        return
    watch, pool = fleet, ThreadPoolExecutor(1)  # a stop waits for no other thread

    @app.get("/fleet/")
    def show_fleet() -> Response:
        secret = access.form_secret if allows_actions else ""
        return answer("fleet", lambda: {"fleet": watch.read(), "secret": secret}, "../")

    if not allows_actions:
        return

    @app.post("/fleet/stop", response_class=HTMLResponse)
    async def stop(request: Request) -> Response:
        if not access.permits_action(request.headers):
            return PlainTextResponse("refused: not from a form of this page\n", 403)
        press = partial(stop_all, watch.bus, reason="pressed on the page", by=f"page, {getpass.getuser()}")
        try:
            found = await asyncio.get_running_loop().run_in_executor(pool, press)
        except ExecutionError as error:
            return HTMLResponse(render("unreadable", error=error), 422)
        if found.silent:
            text = f"No answer from {', '.join(found.silent)}: they latch when back; use the stop of their robots"
            return HTMLResponse(render("unreadable", error=text), 422)
        said = f"The emergency stop is latched on {', '.join(found.stopped) or 'no host'}."
        return HTMLResponse(render("done", done=Done(said, "paos fleet stop", found)))
