"""Luigi: local scheduler, one worker, a marker file for each task."""

import itertools
import logging
from pathlib import Path

import luigi
from timing import measure

EDGES: dict[str, list[list[int]]] = {}
RUNS = itertools.count()


class NoOp(luigi.Task):
    """Writes its marker."""

    folder = luigi.Parameter()
    index = luigi.IntParameter()

    def requires(self) -> "list[NoOp]":
        """The tasks before it."""
        return [NoOp(folder=self.folder, index=before) for before in EDGES[self.folder][self.index]]

    def output(self) -> luigi.LocalTarget:
        """Its marker."""
        return luigi.LocalTarget(f"{self.folder}/{self.index}")

    def run(self) -> None:
        """Nothing but the marker."""
        with self.output().open("w"):
            pass


class Walk(luigi.WrapperTask):
    """Wants every task that no other wants, and through them all; Luigi walks the graph once for each root."""

    folder = luigi.Parameter()

    def requires(self) -> list[NoOp]:
        """The tasks at the end of the graph."""
        edges = EDGES[self.folder]
        wanted = {before for befores in edges for before in befores}
        return [NoOp(folder=self.folder, index=index) for index in range(len(edges)) if index not in wanted]


def run(edges: list[list[int]], scratch: Path) -> int:
    """Build the graph from its root; how many tasks left their marker."""
    folder = scratch / f"luigi-{next(RUNS)}"
    folder.mkdir()
    EDGES[str(folder)] = edges
    luigi.build([Walk(folder=str(folder))], local_scheduler=True, workers=1, log_level="ERROR")
    return len(list(folder.iterdir()))


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    measure("luigi", "marker file, no fsync", "1", run)
