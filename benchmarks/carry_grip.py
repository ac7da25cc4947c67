"""Carries of held things in physics alone: how far each slips in the fingers, timed under the grip and by toppra alone.

A thing of random weight, friction and place between the fingers is gripped at home and carried along a random joint
motion. Slip is measured from the simulator's poses: how far the thing moved and turned in the hand.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from phyagentos.protocol.world.scenes import SceneSpec
from phyagentos.runtime.drivers.mujoco.physics import Physics
from phyagentos.runtime.models.robot import read_profile
from phyagentos.runtime.motion.path import densify
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.requests import Load
from phyagentos.runtime.motion.timing import JointLimits, Timed
from phyagentos.runtime.motion.transport import Care, time_carry

InHand = tuple[np.ndarray, np.ndarray]  # rotation (3, 3) and position (3,)
ROOT = Path(__file__).parents[1]
HALF_M = (0.02, 0.02, 0.02)
SLIPPED_M, SLIPPED_RAD = 0.006, 0.05  # simulated friction creeps by some millimetres a second under great loads
DOUBT = 0.1  # of weight and friction, both to the bad side


@dataclass(frozen=True, slots=True)
class Carried:
    """One carry: how far the thing slipped [m] and turned [rad] in the hand, and how long it took [s]."""

    slip_m: float
    turn_rad: float
    duration_s: float

    @property
    def slipped(self) -> bool:
        """More than a grip gives way without sliding."""
        return self.slip_m > SLIPPED_M or self.turn_rad > SLIPPED_RAD


@cache
def _open() -> tuple[MotionPlanner, JointLimits]:
    planner = MotionPlanner.open(ROOT / "robots" / "panda" / "target.yaml")
    return planner, JointLimits.from_profile(planner.robot.profile)


def carry(seed: int, *, is_shaped: bool) -> Carried:
    """One carry of a seed."""
    rng = np.random.default_rng([20_261_116, seed])
    friction, away = float(rng.uniform(0.2, 0.3)), rng.uniform(-0.006, 0.006, 2)
    heaviest = 0.9 * 2 * 36.0 * friction / 9.81  # gravity alone takes nine tenths of what the grip bears at most
    mass_kg = float(min(rng.uniform(0.6, 1.0) * heaviest, 2.27))
    swing = rng.uniform(-1, 1, 7) * (1.6, 0.5, 0.8, 0.5, 0.8, 0.5, 1.2)
    (planner, limits), (profile, folder) = _open(), read_profile(ROOT / "robots" / "panda" / "target.yaml")
    home = planner.robot.home_rad
    x, y, z = planner._chain.compute_tcp(home)[:3, 3]
    spec = describe_scene((x + away[0], y, z + away[1]), mass_kg, friction)
    physics = Physics.alone(profile, folder, spec, seed)
    physics.start(0.1)
    still = np.zeros_like(home)
    physics.actuation.set_servos(home, still, 0.0)
    physics.step(400)
    lifted = home.copy()
    lifted[3] += 0.15
    load = Load(mass_kg * (1 + DOUBT), (-away[0], 0.0, -away[1]), 0.025, friction * (1 - DOUBT), 36.0)
    play(physics, time_carry(densify(np.array((home, lifted)), 0.05), limits.scale(0.2, 0.2), planner._chain, Care()))
    physics.step(100)
    rows = densify(np.array((lifted, lifted + swing)), 0.05)
    timed = time_carry(rows, limits, planner._chain, Care(load), is_shaped=is_shaped)
    before = find_in_hand(physics)
    play(physics, timed)
    slip_m, turn_rad = compare(before, find_in_hand(physics))
    return Carried(slip_m, turn_rad, timed.trajectory.duration_s)


def compare(one: InHand, other: InHand) -> tuple[float, float]:
    """Distance along the pads [m] and angle [rad] between two poses in the hand."""
    (R, p), (S, q) = one, other
    return float(np.linalg.norm((q - p)[[0, 2]])), float(np.arccos(np.clip((np.trace(R.T @ S) - 1) / 2, -1, 1)))


def play(physics: Physics, timed: Timed) -> None:
    """Follow a timed motion with closed fingers, physics step by physics step."""
    for q, qd in zip(timed.trajectory.q_rad, timed.trajectory.qd_rad_s, strict=True):
        physics.actuation.set_servos(q, qd, 0.0)
        physics.step()


def find_in_hand(physics: Physics) -> InHand:
    """Pose of the thing in the frame of the tool."""
    mujoco.mj_kinematics(physics.model, physics.data)
    position, rotation = physics.queries.find_tcp()
    body = physics.data.body("thing")
    return rotation.T @ body.xmat.reshape(3, 3), rotation.T @ (body.xpos - position)


def describe_scene(at_m: tuple[float, float, float], mass_kg: float, friction: float) -> SceneSpec:
    """A thing on a narrow post, between the fingers of an arm at home."""
    x, y, z = (float(value) for value in at_m)
    foot = z - HALF_M[2] - 0.001
    thing = {"kind": "box", "material": "plastic", "mass_kg": mass_kg, "grip_span": [friction, friction]}
    thing |= {"shapes": [{"kind": "box", "size_m": list(HALF_M)}], "place": {"position_m": [x, y, z]}}
    post = {"kind": "post", "fixed": True, "material": "plastic", "place": {"position_m": [x, y, foot - 0.02]}}
    post["shapes"] = [{"kind": "box", "size_m": [0.004, 0.004, 0.02]}]
    materials = {"plastic": {"surface": "plastic"}}
    return SceneSpec.model_validate(
        {"scene": "carry", "cameras": {}, "materials": materials, "bodies": {"post": post, "thing": thing}}
    )
