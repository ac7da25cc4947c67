"""The robot cell of the tests: a world on disk, a project that knows it as a ROS 2 robot, the processes of both."""

import contextlib
import json
import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import mujoco
import numpy as np
import yaml

from phyagentos.clock import SystemClock
from phyagentos.geometry import compute_quaternion
from phyagentos.operations.ros2 import draft_ros2
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.capabilities.placed_scenes import read_placed
from phyagentos.protocol.settings.sensors import read_sensors
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.models.camera_model import find_mounting
from phyagentos.runtime.models.robot import name_actuator, read_profile
from phyagentos.runtime.models.world import compile_scene
from phyagentos.runtime.targets.handshake import make_key
from phyagentos.runtime.targets.websocket import connect_websocket
from phyagentos.testing import ReachedTarget

HERE, ROOT = Path(__file__).parent, Path(__file__).resolve().parents[3]
KITS = os.pathsep.join(str(ROOT / "kits" / each) for each in ("ros2", "target_server"))
MESSAGES = ROOT / "build" / "ros2" / "messages" / "lib"
SCENE = "tabletop/cubes_and_trays"
CAMERAS = ("overhead", "left", "right", "wrist")
VIEWS = {
    "overhead": ("rgb8", "16UC1"),
    "left": ("jpeg", "16UC1"),
    "right": ("rgb8", "32FC1"),
    "wrist": ("rgb8", "16UC1"),
}  # encodings of colours and depths
OTHER_VIEWS = {"overhead": ("bgr8", "16UC1"), "left": ("png", "16UC1/compressedDepth"),
               "right": ("bgra8", "32FC1/compressedDepth"), "wrist": ("rgba8", "32FC1")}  # fmt: skip
OTHER_HABITS = {"speeds": "nan", "states_every": 3, "extra": ["lift", "pan"], "late_s": 0.03, "best_effort": True,
                "lens": "latched"}  # fmt: skip
PREFIX, NAMESPACE = "fr_", "cell"
CONTROL_PERIOD_S, STEP_S = 0.1, 0.02  # for a machine that does other work besides
CAMERA_HZ, PERIODS = 5, 3  # how many of a camera a picture may be old; the shipped ones have 25 Hz and 0.3 s
HELD = ("ROS_DOMAIN_ID", "PATH", "HOME")
CLOCK = SystemClock()


def write_project(
    folder, *, kind="trajectory", hand=True, cameras=CAMERAS, views=VIEWS, camera_hz=CAMERA_HZ,
    endpoint="ws://127.0.0.1:1", **ros2,
):  # fmt: skip
    """A project whose panda is behind ROS 2, with cameras of 640 x 480 pixels; ros2.yaml is drafted and edited."""
    robot, settings = folder / "robots" / "panda", folder / "protocol"
    shutil.copytree(ROOT / "robots" / "panda", robot)
    shutil.copytree(ROOT / "protocol", settings, ignore=lambda *_: ["schemas", "followers"])
    for name in ("goal_graphs", "scenes", "skills", "trees"):
        (folder / name).mkdir()
    _edit(robot / "target.yaml", kind="real_robot", driver="remote", endpoint=endpoint, silence_max_s=5.0,
          control_period_s=CONTROL_PERIOD_S, physics_step_s=STEP_S)  # fmt: skip
    _edit(
        settings / "runtime_contract.yaml",
        world_mode="realtime",
        control_period_s=CONTROL_PERIOD_S,
        physics_step_s=STEP_S,
    )
    safety = yaml.safe_load((settings / "safety.yaml").read_text())
    safety["targets"]["panda"]["command_validity_max"]["value"] = 5 * CONTROL_PERIOD_S
    safety["targets"]["panda"]["command_rate_max"]["value"] = 1.0 / CONTROL_PERIOD_S
    (settings / "safety.yaml").write_text(yaml.safe_dump(safety))
    sensors = yaml.safe_load((settings / "sensors.yaml").read_text())
    for name in [name for name in sensors["sensors"] if name not in (*cameras, "joint_state")]:
        del sensors["sensors"][name]
    for name in cameras:
        sensors["sensors"][name] |= {"rate_hz": camera_hz}
        sensors["sensors"][name]["camera"] |= {"width": 640, "height": 480}
    (settings / "sensors.yaml").write_text(yaml.safe_dump(sensors))
    perception = yaml.safe_load((settings / "perception.yaml").read_text())
    perception["embedded"]["max_age_s"] = PERIODS / camera_hz
    perception["pipelines"]["world_state"]["sensors"] = list(cameras)
    (settings / "perception.yaml").write_text(yaml.safe_dump(perception))
    with contextlib.chdir(folder):
        draft_ros2("panda")
    _edit_ros2(robot, settings, kind, hand, {name: views[name] for name in cameras}, ros2)
    return folder


def _edit(path, **changes):
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | changes, sort_keys=False))


def _edit_ros2(robot, settings, kind, hand, views, changes):
    given = yaml.safe_load((robot / "ros2.yaml").read_text())
    topic = {"trajectory": "arm_controller/joint_trajectory", "forward": "arm_controller/commands"}[kind]
    given |= {"namespace": NAMESPACE, "use_sim_time": True, "controller": {"kind": kind, "topic": topic}}
    given["controller_manager"] = ""
    given["gripper"] |= {"joints": [PREFIX + name for name in given["gripper"]["joints"]], "force_per_effort": 1.0}
    given["gripper"] |= {"topic": "hand_controller/commands"} if hand else {}
    for name, joint in given["joints"].items():
        joint["name"] = PREFIX + name
    given["cameras"] = {name: _place(robot, settings, name, *views[name]) for name in views}
    given["controller"] |= changes.pop("controller", {})
    (robot / "ros2.yaml").write_text(yaml.safe_dump(given | changes, sort_keys=False))


def _place(robot, settings, name, color, depth):
    """A camera in the world, or on the tool, as a calibration would say."""
    profile, folder = read_profile(robot / "target.yaml")
    scene = compile_scene(((profile, folder),), read_placed(Library.open(), SCENE), 1)
    mujoco.mj_kinematics(scene.model, scene.data)
    camera = read_sensors(settings / "sensors.yaml").cameras[name].camera
    place = find_mounting(scene.model, camera).find(scene.data)
    is_on_tool = camera.mount != "world"
    position_m, turn = place.position_m, place.rotation
    if is_on_tool:
        tool = scene.data.site(profile.tcp)
        back = tool.xmat.reshape(3, 3).T
        position_m, turn = back @ (position_m - tool.xpos), back @ turn
    return {
        **name_topics(name, color, depth), "info": f"{name}/camera_info", "on_tool": is_on_tool,
        "position_m": [float(each) for each in position_m], "reliable": True,
        "quaternion_wxyz": [float(each) for each in compute_quaternion(turn)],
    }  # fmt: skip


def name_topics(name, color, depth):
    """Of colours and depths in these encodings."""
    is_compressed, transport = color in {"jpeg", "png"}, depth.partition("/")[2]
    topics = {"color": [f"{name}/color", *(["compressed"] if is_compressed else [])]}
    topics["depth"] = [f"{name}/depth", *([transport] if transport else [])]
    return {key: "/".join(parts) for key, parts in topics.items()}


def write_plant(folder, project, seed, cameras=CAMERAS):
    """The project's own world of a seed, settled, as files for the emulator."""
    folder.mkdir(parents=True)
    profile, robot = read_profile(ROOT / "robots" / "panda" / "target.yaml")
    spec = read_placed(Library.open(), SCENE)
    physics = Physics.alone(profile, robot, spec, seed)
    physics.start(spec.settle_s)
    model, data = physics.model, physics.data
    (folder / "scene.mjb").write_bytes(physics.scene.export()["scene.mjb"])
    np.savez(folder / "state.npz", qpos=data.qpos, qvel=data.qvel, ctrl=data.ctrl, act=data.act)
    bodies = [each.name for each in physics.scene.entities]
    about = {
        "joints": profile.arm.joints, "fingers": profile.gripper.joints, "seed": seed, "drive": "act_gripper",
        "tcp": profile.tcp, "opened_m": profile.gripper.max_width_m / len(profile.gripper.joints),
        "servos": [name_actuator(name) for name in profile.arm.joints], "lead_s": physics.actuation.lead_s.tolist(),
        "noise": [profile.arm.position_noise_rad, profile.arm.velocity_noise_rad_s], "cameras": list(cameras),
        "sensors": str(project / "protocol" / "sensors.yaml"),
        "bodies": [name for name in bodies if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) >= 0],
        "interiors": {each.name: [list(each.interior.center_m), list(each.interior.half_m)]
                      for each in physics.scene.entities if each.interior is not None},
    }  # fmt: skip
    (folder / "plant.json").write_text(json.dumps(about))
    return folder


class Process:
    """A process that is given lines and answers with lines."""

    def __init__(self, command, log, **environment):
        held = {name: os.environ[name] for name in HELD if name in os.environ}
        given = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOG_DIR": str(log.parent / "roslog"), **environment}
        given = {name: str(value) for name, value in given.items() if value}
        with log.open("ab") as file:
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": file, "text": True}
            self.process = subprocess.Popen(list(map(str, command)), env=held | given, **pipes)
        self._lock = threading.Lock()

    def tell(self, line):
        with self._lock:
            self.process.stdin.write(f"{line}\n")
            self.process.stdin.flush()

    def ask(self, line):
        self.tell(line)
        return json.loads(self.process.stdout.readline())

    def kill(self):
        self.process.kill()
        self.process.wait()

    def close(self):
        self.process.stdin.close()
        try:
            self.process.wait(15.0)
        except subprocess.TimeoutExpired:
            self.kill()
        self.process.stdout.close()
        return self.process.returncode


class Cell:
    """The emulated robot and the kit before it, in one DDS domain."""

    def __init__(
        self, folder, project, python, domain, *, seed=1, pace=1.0, cameras=CAMERAS, views=VIEWS, camera_hz=CAMERA_HZ,
        **options,
    ):  # fmt: skip
        self.folder, self.project, self.python, self.domain = folder, project, python, str(domain)
        self.key, self.stop_file, self.log = make_key(), folder / "stop", folder / "receive-panda.jsonl"
        plant = write_plant(folder / "plant", project, seed, cameras)
        shown = {name: [*views[name], name_topics(name, *views[name])] for name in cameras}
        given = {
            "namespace": NAMESPACE, "prefix": PREFIX, "seed": seed, "pace": pace, "cameras": shown,
            "camera_hz": camera_hz, "kind": "trajectory", "hand": True,
            "controller": {"begins_at_desired": True}, "ros2_control": None, "habits": {},
            "eyes": self._find_eyes(), **options,
        }  # fmt: skip
        command = [python, HERE / "emulator.py", plant, json.dumps(given)]
        is_built = given["ros2_control"] is not None  # its messages are
        self._libraries = MESSAGES if is_built else ""
        self._packages = [str(MESSAGES / "python3.11" / "site-packages")] if is_built else []
        self.robot = self._start(command, "robot.log", self._packages)
        self.robot.ask("truth")
        self.bodies = []

    def _start(self, command, log, packages):
        paths = {"PYTHONPATH": os.pathsep.join(packages), "LD_LIBRARY_PATH": self._libraries}
        return Process(command, self.folder / log, ROS_DOMAIN_ID=self.domain, **paths)

    @staticmethod
    def _find_eyes():
        clean = ["env", "-u", "LD_LIBRARY_PATH", "-u", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", f"PYTHONPATH={ROOT}"]
        return [*clean, sys.executable, str(HERE / "eyes.py")]

    def serve(self):
        """Start the kit; its endpoint, or what it says in its place."""
        command = [self.python, "-m", "ros2_body", self.project / "robots" / "panda" / "target.yaml"]
        command += ["--log", self.log, "--stop-file", self.stop_file]
        body = self._start(command, "body.log", [KITS, *self._packages])
        self.bodies.append(body)
        body.tell(self.key.hex())
        return body.process.stdout.readline().strip()

    def reach(self):
        endpoint = self.serve()
        assert endpoint.startswith("ws://"), (endpoint, (self.folder / "body.log").read_text()[-2000:])
        return ReachedTarget(lambda: connect_websocket(endpoint), self.key)

    def set_stop(self, is_stopped):
        self.stop_file.touch() if is_stopped else self.stop_file.unlink(missing_ok=True)

    def close(self):
        codes = [body.close() for body in self.bodies]
        self.robot.kill()
        self.robot.close()
        return codes
