"""Runs one goal graph with many seeds in one workspace: demonstrations of a teacher, or the trials of a policy.

python run_seeds.py goal_graphs/teach.yaml WORKSPACE --seeds 1000:1120 [--record]
"""

import argparse
from pathlib import Path

from phyagentos.assembly.paths import open_project
from phyagentos.bench.report import Rate
from phyagentos.bench.suite import open_bench
from phyagentos.clock import SystemClock

HERE = Path(__file__).resolve().parent
RECORD = "record: {cameras: [overhead], rate_hz: 5}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("graph", type=Path)
    parser.add_argument("workspace", type=Path)
    parser.add_argument("--seeds", default="0:20", help="FIRST:LAST, without the last one")
    parser.add_argument("--record", action="store_true", help="pictures of the overhead camera, five a second")
    given = parser.parse_args()
    seeds = range(*map(int, given.seeds.split(":")))
    workspace = open_project(given.workspace, HERE)
    if given.record:
        contract = workspace.root / "runtime_contract.yaml"
        contract.write_text(f"{contract.read_text()}\n{RECORD}\n")
    met = 0
    with open_bench(workspace, SystemClock()) as agent:
        for number, seed in enumerate(seeds, 1):
            report = agent.mission.run(given.graph, seed=seed)
            met += report.verdict == "success"
            why = next((s.reason for s in reversed(report.sessions) if s.reason), "")
            print(f"seed {seed}: {report.verdict}  ({met} of {number})  {why}", flush=True)
    print(f"goals met: {Rate(met, len(seeds))}")


if __name__ == "__main__":
    main()
