"""Luigi: local scheduler, one worker, a marker file for each task."""

import itertools
import logging
from pathlib import Path

import luigi
from timing import measure, note

EDGES: dict[str, list[list[int]]] = {}
RUNS = itertools.count()


class NoOp(luigi.Task):
    """Writes its marker."""

    folder = luigi.Parameter()
    index = luigi.IntParameter()
    log = luigi.Parameter(default="")

    def requires(self) -> "list[NoOp]":
        """The tasks before it."""
        befores = EDGES[self.folder][self.index]
        return [NoOp(folder=self.folder, index=before, log=self.log) for before in befores]

    def output(self) -> luigi.LocalTarget:
        """Its marker."""
        return luigi.LocalTarget(f"{self.folder}/{self.index}")

    def run(self) -> None:
        """Nothing but the marker, and the note where one is kept."""
        if self.log:
            note(self.log, self.index)
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


def recover(n: int, log: str, scratch: Path) -> None:
    """What has its marker is done."""
    EDGES[str(scratch)] = [[index - 1] if index else [] for index in range(n)]
    luigi.build([NoOp(folder=str(scratch), index=n - 1, log=log)], local_scheduler=True, workers=1, log_level="ERROR")


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    measure("luigi", "marker file, no fsync", "1", run, recover)
