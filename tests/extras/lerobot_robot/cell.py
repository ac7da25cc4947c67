"""A robot of LeRobot and the kit before it, in LeRobot's own Python."""

import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path

from phyagentos.operations.ros2 import DraftedSettings
from phyagentos.runtime.targets.handshake import make_key
from phyagentos.runtime.targets.websocket import connect_websocket
from phyagentos.testing import ReachedTarget

ROOT = Path(__file__).resolve().parents[3]
KITS = os.pathsep.join(str(ROOT / "kits" / each) for each in ("lerobot_robot", "target_server"))
HELD = ("PATH", "HOME")
LATE = ("There is no status packet", "Missing motor IDs", "Could not connect on port")


def run_kit(python, *arguments, **more):
    """A module of the kit, to its end."""
    command = [python, "-m", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, env=make_environment(more))


def make_environment(more):
    kept = {name: os.environ[name] for name in HELD if name in os.environ}
    return kept | {"PYTHONPATH": KITS, "MUJOCO_GL": "egl", "OMP_NUM_THREADS": "1", **more}


def draft(python, robot, kind, *fields):
    """`lerobot.yaml` of a robot of the project in this folder, by what LeRobot says of its kind."""
    given = [part for each in fields for part in ("--field", each)]
    with contextlib.chdir(robot.parents[1]):
        done = run_paos("robot", "lerobot", robot.name, "described.yaml", "--from", kind, *given, "--python", python)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    return DraftedSettings(file=robot.parents[1] / found["file"], asks=tuple(found["asks"]))


def run_paos(*words):
    command = [Path(sys.executable).with_name("paos"), *map(str, words), "--json"]
    given = os.environ | make_environment({})
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, env=given)


class Server:
    """Processes of the kit before one robot; each has the key of the cell."""

    def __init__(self, python, robot, folder):
        self.python, self.robot, self.folder = python, robot, folder
        self.key, self.stop_file, self.log = make_key(), folder / "stop", folder / "receive.jsonl"
        self._processes, self.installed = [], ""

    def serve(self):
        """The endpoint, or what the kit says in its place."""
        command = [self.python, "-m", "lerobot_robot", self.robot / "target.yaml", "--log", self.log]
        command += ["--stop-file", self.stop_file]
        environment = make_environment({"PYTHONPATH": os.pathsep.join((KITS, self.installed))})
        with (self.folder / "body.log").open("ab") as log:
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": log, "text": True}
            process = subprocess.Popen(list(map(str, command)), env=environment, **pipes)
        self._processes.append(process)
        process.stdin.write(f"{self.key.hex()}\n")
        process.stdin.flush()
        return process.stdout.readline().strip()

    def reach(self):
        self.end()  # a serial port has one user
        endpoint = self.serve()
        if any(
            each in endpoint for each in LATE
        ):  # LeRobot waits 50 ms for a servo, and repeats no question; this machine was busy
            endpoint = self.serve()
        assert endpoint.startswith("ws://"), (endpoint, self.read_log())
        return ReachedTarget(lambda: connect_websocket(endpoint), self.key)

    def read_log(self):
        return (self.folder / "body.log").read_text()[-2000:]

    def set_stop(self, is_stopped):
        self.stop_file.touch() if is_stopped else self.stop_file.unlink(missing_ok=True)

    def end(self):
        """Exit codes of all processes, which end with their input."""
        codes = []
        while self._processes:
            process = self._processes.pop()
            process.stdin.close()
            codes.append(process.wait(30.0))
            process.stdout.close()
        return codes
