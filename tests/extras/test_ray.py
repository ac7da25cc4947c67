"""A sweep on two Ray nodes of one host, one of which is killed while it works: needs the extra `ray` in this Python."""

import os
import threading

import pytest

from phyagentos.bench.matrix import compile_suite
from phyagentos.bench.sweep import begin_run, run_sweep
from phyagentos.clock import SystemClock
from tests.bench.suite_of_counter import ROOT, make_project, read_episodes

pytestmark = [pytest.mark.extras, pytest.mark.journey]
OWN = {"at", "wall_s", "folder", "host"}  # of a run, and of its sessions' `wall_s`, `stages_ms` and `bundle`
SEEDS = 8


def take_result(record):
    """What does not depend on where and when an episode ran."""
    sessions = [
        {key: value for key, value in session.items() if key not in {"wall_s", "stages_ms", "bundle"}}
        for session in record["sessions"]
    ]
    return {key: value for key, value in record.items() if key not in OWN} | {"sessions": sessions}


@pytest.mark.timeout(900)
@pytest.mark.filterwarnings("ignore")
def test_a_node_that_is_killed_in_mid_sweep_loses_and_repeats_no_episode(tmp_path, monkeypatch):
    ray = pytest.importorskip("ray", reason="needs the extra `ray`: make test-extras")
    from ray.cluster_utils import Cluster

    from phyagentos.bench.engines import EngineName, open_engine

    folder = make_project(tmp_path / "p", seeds={"count": SEEDS})
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(folder), str(ROOT))))
    plan = compile_suite(folder / "suite.yaml")

    def sweep(name, engine, on_record=lambda _: None):
        run = folder / name
        manifest = begin_run(run, folder / "suite.yaml", plan, SystemClock())
        for record in run_sweep(run, manifest, engine, {}, SystemClock()):
            on_record(record)
        return run

    local = sweep("local", open_engine(EngineName.LOCAL, 2))
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "dashboard_port": None})
    second = cluster.add_node(num_cpus=1)
    monkeypatch.setenv("RAY_ADDRESS", cluster.address)
    try:
        killed, ended = [], []

        def kill_node():
            killed.append(second.unique_id)
            cluster.remove_node(second, allow_graceful=False)

        def count(record):
            ended.append(record)
            if len(ended) == 3:
                threading.Timer(0.7, kill_node).start()  # both nodes are at work by then

        far = sweep("far", open_engine(EngineName.RAY, 2), count)
    finally:
        ray.shutdown()
        cluster.shutdown()

    lines = (far / "episodes.jsonl").read_text().splitlines()
    assert killed
    assert len(lines) == SEEDS
    ours, theirs = read_episodes(local), read_episodes(far)
    assert ours.keys() == theirs.keys() == {f"lift.{seed}" for seed in range(SEEDS)}
    assert {id: take_result(record) for id, record in ours.items()} == {
        id: take_result(record) for id, record in theirs.items()
    }
    begun = len(list(far.glob("episodes/*")))
    assert begun > SEEDS, "the killed node had begun an episode, which another one began anew"
