"""`paos doctor --warm`: kernels are compiled once, before anything waits for them."""

import json
import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.motion

AFTERWARDS = """
import sys
import numpy as np
from numba.extending import is_jitted
from phyagentos.assembly.kernels import ROBOT, compile_kernels
from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.world.environment import Entity, Pose, Shape, ShapeKind
from phyagentos.runtime.motion.planner import MotionPlanner
from phyagentos.runtime.motion.requests import FindLine, PlanMove, World

def count():
    modules = [module for name, module in sys.modules.items() if name.startswith("phyagentos.")]
    return {f"{m.__name__}.{n}": len(v.signatures) for m in modules for n, v in vars(m).items() if is_jitted(v)}

compile_kernels(Library.open(), lambda name: None)
before, planner = count(), MotionPlanner.open(Library.open().get_target(ROBOT))
wall = Entity(
    name="wall", kind="wall", movable=False, pose=Pose((0.5, 0.0, 0.25)),
    shapes=(Shape(ShapeKind.BOX, (0.3, 0.01, 0.25)),),
)
from_rad, to_rad = (planner.robot.home_rad + np.array((side, 0.5, 0, 0, 0, 0, 0)) for side in (-0.7, 0.7))
motion = planner.answer(PlanMove(world=World((wall,)), q_rad=from_rad, goals_rad=to_rad[None], seed=1))
assert motion.stages.path.iterations > 0, motion
print({name: number for name, number in count().items() if number > before.get(name, 0)})
"""


def test_a_plan_that_is_searched_loads_no_kernel_that_warming_left_out():
    done = subprocess.run([sys.executable, "-c", AFTERWARDS], capture_output=True, text=True, timeout=300, check=False)

    assert (done.returncode, done.stdout.strip()) == (0, "{}"), done.stderr


def test_without_a_folder_for_kernels_the_one_setting_that_helps_is_named(tmp_path):
    """A package and a home that nobody may write to; to the superuser that runs a test, no folder is like that."""
    nowhere = {"NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator", "NUMBA_CACHE_DIR": "/proc/kernels"}
    done = subprocess.run(
        [sys.executable, "-m", "phyagentos", "doctor", "--warm", "--json", str(tmp_path)],
        env={**os.environ, **nowhere},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    (found,) = json.loads(done.stdout)

    assert done.returncode == 1
    assert (found["subject"], found["grade"]) == ("kernels", "broken")
    assert "NUMBA_CACHE_DIR" in found["fix"]
