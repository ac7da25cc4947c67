"""The kit `learned_forecaster`, as if it were installed, and a model of made-up sessions."""

import numpy as np
from learned_forecaster.model import Example

from phyagentos.protocol.capabilities.library import find_shipped_root

KIT = find_shipped_root() / "kits" / "learned_forecaster"


def announce(site) -> None:
    """Write what an installer writes; `site` is a folder on the path of Python."""
    information = site / "learned_forecaster-1.dist-info"
    information.mkdir(parents=True)
    (information / "METADATA").write_text("Metadata-Version: 2.1\nName: learned_forecaster\nVersion: 1\n")
    points = (KIT / "pyproject.toml").read_text().partition('[project.entry-points."')[2].replace('"]', "]", 1)
    (information / "entry_points.txt").write_text("[" + points.partition("\n\n")[0].replace('"', ""))


def draw_examples(count: int, seed: int = 0) -> list[Example]:
    """Sessions that fail the more often, the farther they carry."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        way_m, noise = rng.uniform(0.0, 1.0), rng.normal()
        fails = rng.uniform() < way_m**2
        features = {"skill=carry": 1.0, "thing_to_place_m": way_m, "noise": noise}
        found.append(Example(features, "carry", "GRASP_LOST" if fails else ""))
    return found
