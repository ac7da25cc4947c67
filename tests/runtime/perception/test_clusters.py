"""Clusters against their definition: whatever is linked, point by point, is one cluster."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from phyagentos.runtime.perception.clusters import POINTS_MIN, find_clusters, split

LINK_M = 0.016


def find_by_definition(points, link_m):
    linked = cdist(points, points) <= link_m
    unseen, clusters = set(range(len(points))), []
    while unseen:
        cluster, edge = set(), {min(unseen)}
        while edge:
            cluster |= edge
            edge = set(np.flatnonzero(linked[sorted(edge)].any(axis=0)).tolist()) - cluster
        unseen -= cluster
        clusters.append(sorted(cluster))
    return [cluster for cluster in sorted(clusters, key=lambda each: -len(each)) if len(cluster) >= POINTS_MIN]


@pytest.mark.slow
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(0, 200),
    spread_m=st.sampled_from([0.0, 0.002, 0.01, 0.03, 0.1]),
    middles=st.integers(1, 4),
    apart_m=st.sampled_from([0.02, 0.04, 0.08, 1.0]),
)
def test_clusters_are_those_of_single_links(seed, count, spread_m, middles, apart_m):
    rng = np.random.default_rng(seed)
    around = rng.normal(size=(middles, 3)) * apart_m
    points = around[rng.integers(0, middles, count)] + rng.normal(size=(count, 3)) * spread_m
    assert [cluster.tolist() for cluster in find_clusters(points, LINK_M)] == find_by_definition(points, LINK_M)


@pytest.mark.parametrize(("gap_m", "clusters"), [(0.0159, 1), (0.0161, 2)])
def test_two_dense_plates_are_one_cluster_exactly_when_two_points_are_linked(gap_m, clusters):
    plate = np.stack(np.meshgrid(np.arange(12), np.arange(12), [0]), axis=-1).reshape(-1, 3) * 0.001
    corner = plate[-1] + np.array([gap_m, 0.0, 0.0])
    other = corner + np.stack(np.meshgrid(np.arange(12), np.arange(12), [0]), axis=-1).reshape(-1, 3) * 0.001
    found = find_clusters(np.concatenate((plate, other)), LINK_M)
    assert [len(cluster) for cluster in found] == ([288] if clusters == 1 else [144, 144])


@pytest.mark.parametrize(("apart_m", "parts"), [(0.0, 1), (0.065, 2)])
def test_a_ball_is_not_split_and_two_that_touch_are(apart_m, parts):
    ball = np.random.default_rng(0).normal(size=(200, 3))
    ball *= 0.032 / np.linalg.norm(ball, axis=1)[:, None]
    ball[:, 2] = np.abs(ball[:, 2])  # its upper half, as cameras see it
    points = np.concatenate((ball, ball + np.array([apart_m, 0.0, 0.0])))
    assert len(split(points, 0.064, 2, [])) == parts
