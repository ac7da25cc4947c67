"""Compiles the kernels that test a path: a process of its own, beside the planner's, which compiles the others."""

import gc

import numpy as np

from phyagentos.runtime.motion.moves import thin_out
from phyagentos.runtime.motion.sphere_checker import SphereChecker
from phyagentos.runtime.motion.sphere_model import SphereArrays


def compile_kernels() -> None:
    """Test a path of one joint where nothing is."""
    none, balls, indices = np.zeros(0, dtype=np.int64), np.zeros((0, 4)), np.zeros(2, dtype=np.int64)
    arrays = SphereArrays(
        frames=np.zeros((2, 3, 4)),
        parents=indices,
        slides=0,
        spheres=balls,
        first=indices[:1],
        link=none,
        bounds=balls,
        meets=none,
        pairs=none.reshape(0, 2),
        shrink=np.zeros(0),
        boxes=np.zeros((0, 18)),
        kinds=none,
        crowd=balls,
        crowd_first=indices[:1],
        crowd_bounds=balls,
        weights=np.ones(1),
    )
    checker, path_rad = SphereChecker(arrays), np.zeros((2, 1))
    checker.is_free(path_rad[0])
    checker.path_is_free(path_rad)
    thin_out(path_rad, arrays)


if __name__ == "__main__":
    gc.disable()  # a fifth of the time
    compile_kernels()
