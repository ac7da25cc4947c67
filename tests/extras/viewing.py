"""`paos view` and what it shows in processes of their own, and the system's Chromium without a window."""

import contextlib
import io
import json
import os
import subprocess
import sys
import tarfile
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import numpy as np
from PIL import Image

from tests.following import wait_until

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 240.0  # a browser that draws in software, beside others, waits for its turn
WHAT_CHROMIUM_NEEDS = (
    "--no-sandbox",  # in a container
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-unsafe-swiftshader",
    "--use-gl=angle",
    "--use-angle=swiftshader",
)
WITH_TOKEN = (  # the same command, with a token that a later one has too
    "import secrets, sys; token = sys.argv.pop(1); secrets.token_urlsafe = lambda size: token; "
    "from phyagentos.__main__ import main; main()"
)


def start(*words, **how):
    """`paos …` in a process of its own, which gives way to others."""
    command = ["nice", "-n", "10", sys.executable, "-m", "phyagentos", *map(str, words)]
    return subprocess.Popen(command, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, text=True, **how)


def carry_out(*words, code=0):
    """`paos …` to its end; what it printed."""
    process = start(*words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    out, err = process.communicate(timeout=580)
    assert process.returncode == code, f"paos {words}: {process.returncode}\n{out}{err}"
    return out


@dataclass(frozen=True)
class Served:
    """A server of a page.

    Attributes:
        address: As printed, with the token.
    """

    process: subprocess.Popen
    address: str

    @property
    def origin(self):
        return self.address.partition("/?")[0]

    @property
    def port(self):
        return urlsplit(self.address).port

    @property
    def token(self):
        return parse_qs(urlsplit(self.address).query)["token"][0]

    def end(self, *, kills=False):
        (self.process.kill if kills else self.process.terminate)()
        self.process.communicate(timeout=60)


def serve(root, *options, token="", **how):
    """`paos view` of a workspace."""
    begin = ["-c", WITH_TOKEN, token] if token else ["-m", "phyagentos"]
    command = [sys.executable, *begin, "view", str(root), "--no-browser", *map(str, options)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, **how)
    return Served(process, process.stdout.readline().strip())


@contextlib.contextmanager
def served(root, *options):
    server = serve(root, *options)
    try:
        yield server
    finally:
        server.end()


@dataclass
class Visits:
    """Pages of one browser, each with what it asked for and complained of."""

    browser: object
    allowed: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    contexts: list[object] = field(default_factory=list)

    def open(self, server, path="/", *, width=1400, height=1000, awaits_stream=True, with_scene=False, **how):
        """A page of a server, in a profile of its own; without its 3D scene, which is slow to draw, by default."""
        context = self.browser.new_context(viewport={"width": width, "height": height}, **how)
        self.contexts.append(context)
        context.set_default_timeout(1e3 * PATIENCE_S)
        context.on("request", lambda request: self.asked.append(request.url))
        context.on("weberror", lambda error: self.wrong.append(str(error.error)))
        context.on("dialog", lambda dialog: (self.wrong.append(f"dialog: {dialog.message}"), dialog.dismiss()))
        if not with_scene:
            context.route("**/scene/**", lambda route: route.abort())
        self.allowed.append(urlsplit(server.origin).netloc)
        page = context.new_page()
        page.on("websocket", lambda socket: self.asked.append(socket.url))
        page.goto(server.address)
        if path != "/":
            page.goto(f"{server.origin}{path}")
        if awaits_stream:
            await_live(page)
        return page

    def end(self):
        for context in self.contexts:
            context.close()
        others = [url for url in self.asked if not self.is_own(url)]
        assert not others, "asked of another host"
        assert not self.wrong

    def is_own(self, url):
        parts = urlsplit(url)
        is_scene = parts.hostname == "127.0.0.1" and parts.path.startswith("/scene/")  # on a port of its own
        return parts.scheme in {"data", "blob"} or parts.netloc in self.allowed or is_scene


def await_true(page, expression, limit_s=PATIENCE_S):
    """Until an expression of JavaScript is true; Playwright's own waiting needs `eval`, which the page forbids."""
    wait_until(lambda: page.evaluate(expression), expression, limit_s)


def await_live(page):
    page.locator("#connection.live").wait_for()


def get_panel(page, name):
    return page.locator(f"#panel-{name}")


def get_scene(page, session=""):
    """The frame of the 3D scene, once it is drawn. Playwright itself waits by drawn frames, of which there are few."""
    page.locator("#panel-scene iframe").scroll_into_view_if_needed()

    def find():
        page.wait_for_timeout(100)  # news of frames come while Playwright waits
        frames = [frame for frame in page.frames if f"/scene/{session}" in frame.url]
        fed = "document.body.textContent.includes('Connected')"
        return next((frame for frame in frames if frame.evaluate(fed)), None)

    wait_until(find, "a scene that is fed", PATIENCE_S)
    await_true(page, "document.documentElement.classList.contains('drawn')")
    return find()


def photograph(page):
    """The 3D scene as it is on the screen, without what lies over it, as numbers."""
    box = page.locator("#panel-scene iframe").bounding_box()
    clip = {"x": box["x"], "y": box["y"] + 150, "width": box["width"], "height": box["height"] - 150}
    return np.asarray(Image.open(io.BytesIO(page.screenshot(clip=clip))).convert("RGB")).astype(int)


def is_drawn(picture):
    """Whether there is more than an empty ground."""
    return len(np.unique(picture.reshape(-1, 3), axis=0)) > 500


def differ(first, second):
    """Share of pixels with another colour."""
    return float((np.abs(first - second).max(axis=2) > 24).mean()) if first.shape == second.shape else 1.0


def await_picture(page, is_so, awaited):
    """The first picture of the scene of which something is true."""
    pictures = [photograph(page)]

    def look():
        pictures.append(photograph(page))
        return is_so(pictures[-1])

    wait_until(look, awaited, PATIENCE_S)
    return pictures[-1]


def find_faults(page, axe, *, without=()):
    """Findings of axe-core; `without` are selectors that it does not look at."""
    page.evaluate(axe)
    found = page.evaluate("without => axe.run({exclude: without.map(each => [each])}, {iframes: false})", [*without])
    assert len(found["passes"]) > 10, "it has looked"
    return [
        f"{each['impact']} {each['id']}: {[node['html'][:160] for node in each['nodes']][:4]}"
        for each in found["violations"]
    ]


def read_axe(archive):
    """The script of axe-core out of its npm package."""
    with tarfile.open(archive) as packed:
        return packed.extractfile("package/axe.min.js").read().decode()


def find_wide(page):
    """What reaches over the edge of the screen, outside regions that scroll."""
    return page.evaluate(
        """() => {
          const wide = [];
          const scrolls = each => {
            for (let at = each.parentElement; at && at !== document.body; at = at.parentElement) {
            if (['auto', 'scroll', 'hidden'].includes(getComputedStyle(at).overflowX)) return true; } return false; };
          for (const each of document.body.querySelectorAll('*')) {
            const box = each.getBoundingClientRect();
            if (box.width && box.right > innerWidth + 0.5 && !scrolls(each)) wide.push(each.outerHTML.slice(0, 120));
          }
          if (document.documentElement.scrollWidth > innerWidth) wide.push('the document');
          return wide; }"""
    )


def shoot(page, name, *, whole=True):
    """Keep a picture of a page in the folder SCREENSHOTS of the environment, for people to look at."""
    if folder := os.environ.get("SCREENSHOTS"):
        page.screenshot(path=Path(folder) / f"{name}.png", full_page=whole)


def read_lines(path):
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
