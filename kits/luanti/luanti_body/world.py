"""Worlds of Luanti: a server of one's own in a temporary folder, from a world that is made once for each seed.

A world that is generated twice from a seed differs in trees and liquids, by the order in which its parts are generated.
So it is made once, its land around the start generated, and kept; each episode begins with a copy of that folder.
Worlds are kept in the folder `LUANTI_WORLDS`, else in one below the user's cache.
"""

import contextlib
import json
import os
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from target_server.wire import Refusal

from luanti_body.player import Player

SERVER = Path("/usr/lib/minetest/minetestserver")  # the wrapper in /usr/games insists on its own configuration
SHARE = Path("/usr/share/games/minetest")
SOCKETS = "lua/5.1/socket/core.so"
INSTALL = (
    "apt-get install --no-install-recommends minetest-server minetest-data minetest-mod-mesecons "
    "minetest-mod-3d-armor minetest-mod-moreores minetest-mod-mobs-redo lua-socket"
)
WORLDS = "LUANTI_WORLDS"
GAME, MODS = "minetest", ("mesecons", "3d_armor", "moreores", "mobs_redo")
NAME, AROUND, MORNING, START = "agent", 56, 0.25, "start.json"
START_S, ANSWER_S = 120.0, 120.0
LIFT = 1100  # nodes by which the land is lifted: above 1025 the game's own table of ores is that of its depths
SETTINGS = f"""
server_announce = false
bind_address = 127.0.0.1
enable_damage = true
creative_mode = false
time_speed = 0
num_emerge_threads = 1
dedicated_server_step = 0.01
server_unload_unused_data_timeout = 100000
disallow_empty_password = false
secure.enable_security = true
secure.trusted_mods = phyagentos
mg_name = v7
water_level = {LIFT + 1}
mgv7_mount_zero_level = {LIFT}
mgv7_large_cave_depth = {LIFT - 33}
mgv7_np_terrain_base = {{
	offset = {LIFT + 4}, scale = 70, spread = (600, 600, 600), seed = 82341,
	octaves = 5, persistence = 0.6, lacunarity = 2.0, flags = eased
}}
mgv7_np_terrain_alt = {{
	offset = {LIFT + 4}, scale = 25, spread = (600, 600, 600), seed = 5934,
	octaves = 5, persistence = 0.6, lacunarity = 2.0, flags = eased
}}
"""


class CallRefused(Exception):
    """The game does not do it; the message says why."""


class Link:
    """Calls of the mod in a server, one line of JSON in each direction."""

    def __init__(self, port: int, is_alive: Callable[[], bool]) -> None:
        end = time.monotonic() + START_S
        while True:
            with contextlib.suppress(OSError):
                self._socket = socket.create_connection(("127.0.0.1", port), 1.0)
                break
            if not is_alive() or time.monotonic() > end:
                raise Refusal("TARGET_LOST", f"no server of Luanti at port {port} within {START_S:g} s")
            time.sleep(0.05)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(ANSWER_S)
        self._lines, self._number = self._socket.makefile("r", encoding="utf-8"), 0

    def call(self, name: str, **args: Any) -> dict[str, Any]:
        """The answer of a call; raises `CallRefused`, and `Refusal` when the server is gone."""
        self._number += 1
        line = json.dumps({"id": self._number, "call": name, "args": args}) + "\n"
        try:
            self._socket.sendall(line.encode())
            answer = json.loads(self._lines.readline())
        except (OSError, ValueError) as error:
            raise Refusal("TARGET_LOST", f"the server of Luanti did not answer {name}: {error}") from error
        if "error" in answer:
            raise CallRefused(str(answer["error"]))
        result: dict[str, Any] = answer.get("result") or {}
        return result

    def close(self) -> None:
        """End the connection."""
        self._lines.close()
        self._socket.close()


class World:
    """A server with one player in it."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder = folder
        game_port, port = _find_port(socket.SOCK_DGRAM), _find_port(socket.SOCK_STREAM)
        _write_world(folder, seed, port)
        given = {"config": folder / "server.conf", "world": folder, "gameid": GAME, "port": game_port}
        given |= {"logfile": folder / "server.log"}
        command = [str(SERVER), *(text for key, value in given.items() for text in (f"--{key}", str(value)))]
        environment = os.environ | {"HOME": str(folder), "LANG": "C"}
        with (folder / "output.log").open("w", encoding="utf-8") as output:
            self._process = subprocess.Popen(command, env=environment, stdout=output, stderr=output)
        self.link = Link(port, lambda: self._process.poll() is None)
        self._player: Player | None = None
        self._game_port = game_port

    def begin(self, start: list[int]) -> None:
        """Let the player join, and stand at the start in the morning with empty hands."""
        self._player = Player(self._game_port, NAME)
        self._player.start()
        end = time.monotonic() + START_S
        while not self.link.call("begin", start=start, day=MORNING)["is_there"]:
            if self._player.denied or time.monotonic() > end:
                raise Refusal("TARGET_LOST", f"the player could not join: {self._player.denied or 'no answer'}")
            time.sleep(0.05)

    def close(self) -> None:
        """End the server; it saves its world."""
        if self._player is not None:
            self._player.leave()
        with contextlib.suppress(CallRefused, Refusal):
            self.link.call("stop")
        self.link.close()
        try:
            self._process.wait(30.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


@contextlib.contextmanager
def open_server(seed: int = 0) -> Iterator[World]:
    """A server without a player, in a folder that is removed afterwards: for the game's book."""
    with tempfile.TemporaryDirectory(prefix="luanti-") as folder:
        world = World(Path(folder), seed)
        try:
            yield world
        finally:
            world.close()


def open_world(seed: int, folder: Path, beat: Callable[[], None]) -> tuple[World, list[int]]:
    """A copy of the world of a seed in `folder`, its server running, and its start; it is made where it is new.

    Args:
        seed: Of the map.
        folder: Empty.
        beat: Called between what takes long.
    """
    kept = find_worlds() / f"{seed}"
    if not (kept / START).exists():
        _make_world(seed, kept)
        beat()
    shutil.copytree(kept, folder, symlinks=True, dirs_exist_ok=True)
    start: list[int] = json.loads((folder / START).read_text(encoding="utf-8"))
    return World(folder, seed), start


def find_worlds() -> Path:
    """The folder where worlds are kept."""
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(os.environ.get(WORLDS) or Path(cache) / "phyagentos" / "luanti")


def _make_world(seed: int, kept: Path) -> None:
    kept.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".making-", dir=kept.parent) as name:
        folder = Path(name) / "world"
        folder.mkdir()
        world = World(folder, seed)
        try:
            start = world.link.call("make", around=AROUND)["start"]
        except CallRefused as error:
            raise Refusal("REQUEST_INVALID", f"seed {seed} makes no world to begin in: {error}") from error
        finally:
            world.close()
        (folder / START).write_text(json.dumps([round(each) for each in start]), encoding="utf-8")
        with contextlib.suppress(OSError):  # another process has made it meanwhile
            folder.rename(kept)


def _write_world(folder: Path, seed: int, port: int) -> None:
    """The files of a world, and of its server; a map that is there stays."""
    mods = folder / "worldmods"
    shutil.rmtree(mods, ignore_errors=True)
    shutil.copytree(Path(__file__).parent / "mod", mods / "phyagentos")
    for each in MODS:
        (mods / each).symlink_to(SHARE / "mods" / each)
    text = f"gameid = {GAME}\nbackend = sqlite3\nplayer_backend = sqlite3\nauth_backend = sqlite3\n"
    (folder / "world.mt").write_text(text, encoding="utf-8")
    for each in ("players.sqlite", "auth.sqlite"):
        (folder / each).unlink(missing_ok=True)
    own = f"fixed_map_seed = {seed}\nphyagentos_port = {port}\nphyagentos_socket = {_find_sockets()}\n"
    (folder / "server.conf").write_text(SETTINGS + own, encoding="utf-8")


def _find_sockets() -> Path:
    """The core of LuaSocket; raises `Refusal` with what to install."""
    found = next(Path("/usr/lib").glob(f"*/{SOCKETS}"), None) or Path("/usr/lib") / SOCKETS
    lacking = [str(each) for each in (SERVER, found, *(SHARE / "mods" / each for each in MODS)) if not each.exists()]
    if lacking:
        raise Refusal("REQUEST_INVALID", f"Luanti is not installed here ({', '.join(lacking)}): {INSTALL}")
    return found


def _find_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as free:
        free.bind(("127.0.0.1", 0))
        port: int = free.getsockname()[1]
    return port
