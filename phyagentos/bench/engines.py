"""Where episodes are carried out: processes of this machine, or a Ray cluster (extra `ray`).

An engine only carries jobs out; the sweep keeps the records, so that an episode that a lost node had begun, and another
one repeats, is counted once.
"""

import os
import threading
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from enum import StrEnum
from typing import Any, Protocol

import msgspec
from typing_extensions import override

from phyagentos.bench.episode import Job, carry_out
from phyagentos.bench.records import EpisodeRecord
from phyagentos.errors import DefinitionError

PASSED_ON = ("PHYAGENTOS_MODELS", "PHYAGENTOS_ENVIRONMENTS", "MENAGERIE_ROOT", "PYTHONPATH", "MUJOCO_GL")


class EngineName(StrEnum):
    """Where episodes are carried out."""

    LOCAL = "local"
    """Processes of this machine."""
    RAY = "ray"
    """A Ray cluster; every node sees the folder of the run."""


class Engine(Protocol):
    """Carries jobs out, so many at a time."""

    jobs: int

    def submit(self, job: Job) -> None:
        """Begin a job, at once or when there is room."""

    def wait(self) -> list[EpisodeRecord]:
        """Records of the jobs that have ended since the last call; waits for the first one."""

    def close(self) -> None:
        """End what still runs; it leaves no record."""


class LocalEngine(Engine):
    """A process of this machine for each job."""

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._pool = ThreadPoolExecutor(jobs, thread_name_prefix="episode")
        self._running: set[Future[EpisodeRecord | None]] = set()
        self._ends = threading.Event()

    @override
    def submit(self, job: Job) -> None:
        self._running.add(self._pool.submit(carry_out, job, self._ends.is_set))

    @override
    def wait(self) -> list[EpisodeRecord]:
        done, self._running = wait(self._running, return_when=FIRST_COMPLETED)
        return [record for each in done if (record := each.result()) is not None]

    @override
    def close(self) -> None:
        self._ends.set()
        self._pool.shutdown(cancel_futures=True)


class RayEngine(Engine):
    """A task of a Ray cluster for each job, one CPU each; a task whose node is lost runs again on another one."""

    def __init__(self, ray: Any, jobs: int) -> None:
        self.jobs, self._ray = jobs, ray
        environment = {name: os.environ[name] for name in PASSED_ON if name in os.environ}
        options = {"num_cpus": 1, "max_retries": -1, "runtime_env": {"env_vars": environment}}
        self._task = ray.remote(**options)(_carry_out_packed)
        self._running: list[Any] = []

    @override
    def submit(self, job: Job) -> None:
        self._running.append(self._task.remote(msgspec.json.encode(job)))

    @override
    def wait(self) -> list[EpisodeRecord]:
        done, self._running = self._ray.wait(self._running, num_returns=1)
        return [msgspec.json.decode(data, type=EpisodeRecord) for data in self._ray.get(done)]

    @override
    def close(self) -> None:
        for each in self._running:
            self._ray.cancel(each, force=True)


def _carry_out_packed(job: bytes) -> bytes:
    record = carry_out(msgspec.json.decode(job, type=Job))
    assert record is not None  # nothing ends it early
    return msgspec.json.encode(record)


def open_engine(name: EngineName, jobs: int) -> Engine:
    """The engine of this name; raises DefinitionError `RAY_MISSING`."""
    return _OPEN[name](jobs)


def _open_ray(jobs: int) -> Engine:
    try:
        import ray
    except ImportError as error:
        hint = "pip install 'phyagentos[ray]', here and on every node."
        raise DefinitionError.of("RAY_MISSING", "--engine ray", str(error), "the package ray", hint) from error
    if not ray.is_initialized():
        ray.init(address=os.environ.get("RAY_ADDRESS"), log_to_driver=False)
    return RayEngine(ray, jobs)


_OPEN: dict[EngineName, Callable[[int], Engine]] = {EngineName.LOCAL: LocalEngine, EngineName.RAY: _open_ray}
