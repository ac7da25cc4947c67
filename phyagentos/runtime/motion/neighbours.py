"""Other robots of the same world as obstacles: spheres where each stands, and along the motion that it has announced.

What a neighbour holds moves with its hand. Its fingers are covered wide open and closed. A sphere cover is coarse, and
a neighbour may stop anywhere on its way: the margin is that of the admission of motions, and more.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from phyagentos.geometry import compute_inverse, compute_matrix
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.schema import read_yaml, validate
from phyagentos.protocol.world.environment import Entity
from phyagentos.runtime.motion.chain import build_chain, compute_links
from phyagentos.runtime.motion.requests import Array, Neighbour
from phyagentos.runtime.motion.robot_model import build_robot_model
from phyagentos.runtime.motion.sphere_model import cover_shape, iter_clusters, move_spheres

MARGIN_M = 0.04  # around a cover that stands out of the robot by a centimetre at most
MET_M = -0.004  # where the hand comes near it on purpose: less than what the cover stands out


class NeighbourModel:
    """Covers one robot, whose profile is `robots/<name>/target.yaml`."""

    def __init__(self, profile_file: Path) -> None:
        robot = build_robot_model(validate(TargetProfile, read_yaml(profile_file)), profile_file.parent)
        self._chain = build_chain(robot)
        self._clusters = [(link, cover) for link, _, cover in iter_clusters(robot, self._chain)]

    def cover(self, neighbour: Neighbour, entities: Sequence[Entity]) -> list[Array]:
        """Groups of spheres (k, 4) in the world that contain it, and what it holds, in each of its postures."""
        margin_m = MET_M if neighbour.is_met else MARGIN_M
        tool_T_world = compute_inverse(self._chain.compute_tcp(neighbour.postures_rad[0]))
        held = [
            move_spheres(cover_shape(shape), tool_T_world @ compute_matrix(entity.pose) @ compute_matrix(shape.pose))
            for entity in entities
            if entity.held_by == neighbour.name and not neighbour.is_met  # else it is what the hand comes for
            for shape in entity.shapes
        ]
        groups, links, T = [], np.zeros_like(self._chain.frames), np.eye(4)
        for index, (q_rad, tcp) in enumerate(
            zip(neighbour.postures_rad, self._chain.compute_tcp_path(neighbour.postures_rad), strict=True)
        ):
            compute_links(q_rad, self._chain.frames, self._chain.parents, self._chain.slides, links)
            for link, cover in self._clusters:
                if link or not index:  # the base stands
                    T[:3] = links[link]
                    groups.append(move_spheres(cover, T))
            groups += [move_spheres(cover, tcp) for cover in held]
        for group in groups:
            group[:, 3] += margin_m
        return groups
