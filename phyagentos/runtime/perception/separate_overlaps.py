"""Separates overlapping fits: a pose that penetrates its support is fitted once more.

From one side a coin that lies and a coin on its rim look nearly alike; only one of them rests on the surface below.
Depth is the deepest point of one surface within the other solid, as in penetration queries of collision detection.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from phyagentos.runtime.perception.fitting import Fit, Patch, evaluate_prior_pose, fit, measure_sunk
from phyagentos.runtime.perception.inventory import ObjectModel
from phyagentos.runtime.perception.solids import Array, Solids
from phyagentos.runtime.perception.views import Cloud, Views

SUNK_M = 0.005  # depths and calibration err by less than this
WITHIN = 0.7  # of half its least extent: with its middle so deep in another one, an object is not where that is


def separate_overlaps(
    objects: Mapping[str, ObjectModel],
    fits: Mapping[str, Fit],
    seen: Mapping[str, Cloud],
    views: Views,
    map_solids: Solids,
    priors: Mapping[str, tuple[Array, Array]],
) -> dict[str, Fit]:
    """The fits; those that penetrate the map or another fit are fitted anew, the one with fewer points first.

    One that is where another one is all the same is left out: its points are of that one.

    `seen` are the points of each fit; `map_solids` are in the world; `priors` are poses from which it may not have
    moved: what is almost covered is seen at its rim, which fits somewhat higher or tilted, too.
    """
    apart = dict(fits)
    rank = {name: (len(seen[name].points_m), name) for name in fits}
    for name in sorted(fits, key=rank.__getitem__):
        item, own = objects[name], apart[name]
        others = Solids.of(())
        for other, found in apart.items():
            near_m = (objects[other].diameter_m + item.diameter_m) / 2
            is_near = float(np.linalg.norm(found.position_m - own.position_m)) < near_m
            if other != name and rank[other] > rank[name] and is_near:
                others = others.join(objects[other].solids.at(found.rotation, found.position_m))
        obstacle = map_solids.join(others)
        sunk_m = measure_sunk(item, own.rotation, own.position_m, obstacle)
        if sunk_m >= SUNK_M:
            again = fit(item, seen[name], views, (own.rotation, own.position_m), obstacle)
            apart[name] = again or replace(own, sunk_m=sunk_m)
            if name in priors and apart[name].sunk_m >= SUNK_M:
                stays = evaluate_prior_pose(item, Patch.of(seen[name], views), views, priors[name], obstacle)
                apart[name] = min(apart[name], stays, key=lambda each: each.cost_m)
        if others.kinds and _is_within(item, apart[name], others):
            del apart[name]
    return apart


def _is_within(item: ObjectModel, own: Fit, others: Solids) -> bool:
    """Whether the middle of an object is deep within other ones."""
    low, high = item.samples_m.min(axis=0), item.samples_m.max(axis=0)
    middle = own.position_m + own.rotation @ ((low + high) / 2)
    return -float(others.measure(middle[None])[0]) > WITHIN * float((high - low).min()) / 2
