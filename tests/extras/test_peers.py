"""The systems that `benchmarks/orchestration.py` compares with run, in an environment that has them."""

import json
import os
import subprocess
from pathlib import Path

import pytest

from benchmarks.orchestration_recovery import PEERS as RECOVERED
from benchmarks.orchestration_recovery import carry_on_peer

PEERS = Path(__file__).resolve().parents[2] / "benchmarks" / "orchestration_peers"

pytestmark = pytest.mark.extras


@pytest.mark.parametrize("shape", ["chain", "layered"])
@pytest.mark.parametrize("peer", sorted(path.stem for path in PEERS.glob("run_*.py")))
def test_a_peer_does_every_task_and_says_how_long_it_took(pytestconfig, tmp_path, peer, shape):
    command = [pytestconfig.option.peers_python, str(PEERS / f"{peer}.py"), shape, "20"]
    environment = os.environ | {"DO_NOT_TRACK": "1", "HOME": str(tmp_path)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment, check=False)

    assert done.returncode == 0, done.stderr[-4000:]
    (told,) = [json.loads(line) for line in done.stdout.splitlines() if line.startswith('{"seconds"')]
    assert told["seconds"] > 0.0
    assert told["version"]


@pytest.mark.parametrize("peer", RECOVERED)
def test_a_peer_that_was_killed_goes_on_and_loses_no_task(pytestconfig, tmp_path, peer):
    carried = carry_on_peer(peer, pytestconfig.option.peers_python, tmp_path, 40)

    assert carried.ended, (tmp_path / "printed").read_text()[-4000:]
    assert carried.counts.keys() == set(range(40))
    assert carried.count_repeated() <= 1
