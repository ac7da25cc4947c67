"""Toppra is loaded without matplotlib, which stays importable for whatever else wants it."""

import subprocess
import sys

import pytest


@pytest.mark.slow
def test_timing_loads_no_matplotlib_and_leaves_the_real_one_to_others():
    program = (
        "import sys, phyagentos.runtime.motion.timing\n"
        "assert not [name for name in sys.modules if name.split('.')[0] == 'matplotlib'], 'loaded'\n"
        "from matplotlib import pyplot\n"
        "assert pyplot.__file__\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
