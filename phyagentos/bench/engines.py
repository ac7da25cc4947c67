"""Where episodes are carried out: processes of this machine, or a Ray cluster (extra `ray`).

An engine only carries jobs out; the sweep keeps the records, so that an episode that a lost node had begun, and another
one repeats, is counted once.
"""

import os
import threading
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, nullcontext
from enum import StrEnum

import msgspec

from phyagentos.assembly.libraries import WITH_KERNELS
from phyagentos.bench.episode import POLL_S, Job, carry_out
from phyagentos.bench.records import EpisodeRecord
from phyagentos.errors import DefinitionError, format_install
from phyagentos.fork_server import fork_server

PASSED_ON = ("PHYAGENTOS_MODELS", "PHYAGENTOS_ENVIRONMENTS", "MENAGERIE_ROOT", "PYTHONPATH", "MUJOCO_GL")
CarryOut = Callable[[Job, Callable[[], bool]], EpisodeRecord | None]


class EngineName(StrEnum):
    """Where episodes are carried out."""

    LOCAL = "local"
    """Processes of this machine."""
    RAY = "ray"
    """A Ray cluster; every node sees the folder of the run."""


class Engine:
    """Carries jobs out, so many at a time, while the block `around` runs, until `ends`; a thread waits for each."""

    def __init__(
        self,
        jobs: int,
        carry: CarryOut,
        around: AbstractContextManager[None] | None = None,
        ends: threading.Event | None = None,
    ) -> None:
        self.jobs, self.around, self.ends = jobs, around or nullcontext(), ends or threading.Event()
        self._pool = ThreadPoolExecutor(jobs, thread_name_prefix="episode")
        self._running: set[Future[EpisodeRecord | None]] = set()
        self._carry = carry

    def submit(self, job: Job) -> None:
        """Begin a job, at once or when there is room."""
        self._running.add(self._pool.submit(self._carry, job, self.ends.is_set))

    def wait(self) -> list[EpisodeRecord]:
        """Records of the jobs that have ended since the last call; waits for the first one."""
        done, self._running = wait(self._running, return_when=FIRST_COMPLETED)
        return [record for each in done if (record := each.result()) is not None]

    def close(self) -> None:
        """End what still runs; it leaves no record."""
        self.ends.set()
        self._pool.shutdown(cancel_futures=True)


def open_engine(name: EngineName, jobs: int, ends: threading.Event | None = None) -> Engine:
    """The engine of this name; raises DefinitionError `EXTRA_MISSING`."""
    if name is EngineName.LOCAL:
        return Engine(jobs, carry_out, fork_server(WITH_KERNELS), ends)
    return Engine(jobs, _join_cluster(), ends=ends)


def _join_cluster() -> CarryOut:
    """Carries a job out as a task of the cluster, one CPU each; where its node is lost, again on another one."""
    try:
        import ray
    except ImportError as error:
        hint = f"{format_install('ray')} Do so here and on every node."
        raise DefinitionError.of("EXTRA_MISSING", "--engine ray", str(error), "the package ray", hint) from error
    if not ray.is_initialized():
        ray.init(address=os.environ.get("RAY_ADDRESS"), log_to_driver=False)
    environment = {name: os.environ[name] for name in PASSED_ON if name in os.environ}
    options = {"num_cpus": 1, "max_retries": -1, "runtime_env": {"env_vars": environment}}
    task = ray.remote(**options)(_carry_out_packed)

    def carry(job: Job, is_ended: Callable[[], bool]) -> EpisodeRecord | None:
        running = task.remote(msgspec.json.encode(job))
        while not (done := ray.wait([running], timeout=POLL_S)[0]):
            if is_ended():
                ray.cancel(running, force=True)
                return None
        return msgspec.json.decode(ray.get(done[0]), type=EpisodeRecord)

    return carry


def _carry_out_packed(job: bytes) -> bytes:
    return msgspec.json.encode(carry_out(msgspec.json.decode(job, type=Job)))
