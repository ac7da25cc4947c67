"""A robot's body behind an emulator of its vendor's wire: MuJoCo, paced by the machine's clock in a thread."""

import threading
import time
from pathlib import Path

import mujoco
import numpy as np


class Plant:
    """Named joints with one position servo each; `on_step(dt)` is called before every physics step."""

    def __init__(self, model, joints, servos, q_rad, on_step=lambda dt: None):
        self.model, self.data, self.lock = model, mujoco.MjData(model), threading.RLock()
        self._q = [model.joint(name).qposadr[0] for name in joints]
        self._v = [model.joint(name).dofadr[0] for name in joints]
        self._u = [model.actuator(name).id for name in servos]
        self._gains = model.actuator_gainprm[self._u].copy(), model.actuator_biasprm[self._u].copy()
        self.on_step = on_step
        self.place(q_rad)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True, name="plant")

    def place(self, q_rad):
        """Stand there, at rest, as a person puts it before it is switched on."""
        with self.lock:
            self.data.qpos[self._q], self.data.qvel[:] = q_rad, 0.0
            self.data.ctrl[self._u] = q_rad
            mujoco.mj_forward(self.model, self.data)

    def start(self):
        self._due_s = time.perf_counter()
        self._thread.start()
        return self

    def close(self):
        self._ended.set()
        self._thread.join()

    def command(self, q_rad):
        """Set-points of the servos (n,)."""
        self.data.ctrl[self._u] = q_rad

    def power(self, powered):
        """Which servos push (n,)."""
        gains, biases = self._gains
        on = np.asarray(powered)[:, None]
        self.model.actuator_gainprm[self._u], self.model.actuator_biasprm[self._u] = gains * on, biases * on

    def read(self):
        """Positions and velocities of the joints."""
        with self.lock:
            self.advance()
            return self.data.qpos[self._q].copy(), self.data.qvel[self._v].copy()

    def advance(self):
        """Let the body's time reach the clock's; what comes from outside comes after."""
        with self.lock:
            while self._due_s <= time.perf_counter():
                self.on_step(self.model.opt.timestep)
                mujoco.mj_step(self.model, self.data)
                self._due_s += self.model.opt.timestep

    def _run(self):
        while not self._ended.wait(0.005):
            self.advance()


def read_model(path, is_fixed=False):
    """The model without the visual meshes that the copy of it lacks; fixed where it would float."""
    spec = mujoco.MjSpec.from_file(str(path))
    floating = [joint for joint in spec.joints if is_fixed and joint.type == mujoco.mjtJoint.mjJNT_FREE]
    for element in [*floating, *(spec.keys if floating else [])]:
        spec.delete(element)
    folder = Path(path).parent / spec.meshdir
    absent = {mesh.name for mesh in spec.meshes if not (folder / mesh.file).is_file()}
    for geom in [geom for geom in spec.geoms if geom.meshname in absent]:
        assert (geom.contype, geom.conaffinity) == (0, 0), geom.meshname
        spec.delete(geom)
    for mesh in [mesh for mesh in spec.meshes if mesh.name in absent]:
        spec.delete(mesh)
    return spec.compile()
