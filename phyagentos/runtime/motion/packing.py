"""Sites of one thing beside which everything that still comes to the same container has room at the same time.

A bounded search over rectangles, along the walls or across. Upstream: `sites`. Downstream: `placements`.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, islice, product

import numpy as np

from phyagentos.geometry import compute_matrix
from phyagentos.runtime.motion import sites
from phyagentos.runtime.motion.requests import Array, FindPlacements
from phyagentos.runtime.motion.shapes import Box
from phyagentos.runtime.motion.sites import Placing, Site, Sites, Space

TRIES_MAX = 60  # rectangles that are placed for what still comes, for each way in which the first one is turned
WIDTH = 4  # sites of each


def find_joint_sites(placing: Placing, attitudes: Mapping[int, Array]) -> Sites:
    """Sites for `attitudes` (3, 3) by yaw [degrees]; then those where something removable has to go for the others.

    Last come the corners, which leave most where no arrangement of all was found. None where nothing else comes.
    """
    request, space = placing.request, placing.space
    rest = _list_rest(request, space) if space.walled else []
    if not rest:
        return Sites(iter(()))
    near = (space.center_m, np.inf) if request.near is None else (np.array(request.near), request.near_radius_m)
    rectangles = {degrees: sites.measure_rectangle(placing.held, R) for degrees, R in attitudes.items()}
    taken = sites.list_neighbours(placing)
    staying = sites.list_neighbours(placing, without=set(request.removable) - set(request.coming))

    def iter_beside(others: list[Box]) -> Iterator[Site]:
        sides = sorted({tuple(half_m.round(4).tolist()) for half_m in rectangles.values()})
        for gap_m, side in product((sites.TILE_GAP_M, sites.GAP_M), sides):
            half_m, tries = np.array(side), iter(range(TRIES_MAX))
            yaws = tuple(degrees for degrees, each in rectangles.items() if np.abs(each - half_m).max() < 1e-4)
            for site in sites.pack(space, half_m, 0, near, taken):
                if _has_room(space, [*others, _make_box(space, site, half_m, gap_m)], rest, gap_m, tries):
                    yield replace(site, yaws=yaws)

    def iter_corners() -> Iterator[Site]:
        for degrees, half_m in rectangles.items():
            for site in sites.pack(space, half_m, degrees, near, taken):
                at_m = np.abs(space.rotation.T @ (site.point_m - space.center_m))[:2]
                if np.allclose(at_m, space.half_m - half_m - sites.GAP_M):
                    yield site

    found = [islice(iter_beside(others), sites.SITES_MAX) for others in (taken, staying)]
    return Sites(chain(*found, iter_corners()))


def _list_rest(request: FindPlacements, space: Space) -> list[Array]:
    """Rectangles (2,) of what still comes, the largest first; what lies over the space is there already."""
    rest = []
    for each in request.world.entities:
        away_m = np.abs(space.rotation.T @ (each.pose.position_m - space.center_m))[:2]
        if each.name in request.coming and np.any(away_m > space.half_m):
            rest.append(sites.measure_footprint(each, compute_matrix(each.pose)[:3, :3]).half_m)
    return sorted(rest, key=lambda half_m: -float(np.prod(half_m)))


def _has_room(space: Space, taken: list[Box], rest: Sequence[Array], gap_m: float, tries: Iterator[int]) -> bool:
    """Whether rectangles fit beside what is taken, as far as the search finds."""
    for half_m in (rest[0], rest[0][::-1]) if rest else ():
        found = sites.pack(space, half_m, 0, (space.center_m, np.inf), taken) if next(tries, None) is not None else []
        boxes = (_make_box(space, site, half_m, gap_m) for site in found[:WIDTH])
        if any(_has_room(space, [*taken, box], rest[1:], gap_m, tries) for box in boxes):
            return True
    return not rest


def _make_box(space: Space, site: Site, half_m: Array, gap_m: float) -> Box:
    """What stands at a site, from above, with what its gap is wider than that to the walls."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = space.rotation, site.point_m
    return Box(pose, np.append(half_m + gap_m - sites.GAP_M, 0.0))
