"""How large a test is, where it works, and how it tells its figures."""

import shutil
import tempfile
from pathlib import Path

import pytest

from .real_disk import can_cut_power

HERE = Path(__file__).parent
MEMORY = Path("/dev/shm")

collect_ignore = [] if can_cut_power() else ["test_real_disk.py"]


def pytest_collection_modifyitems(config, items):
    for item in items:
        if config.getoption("--nightly") and item.path.parent == HERE:
            item.add_marker(pytest.mark.timeout(0))


def pytest_report_header():
    found = "yes" if can_cut_power() else "no: needs root, a loop device and mkfs.ext4; recorded calls are replayed"
    return f"durability: power cuts of a real file system: {found}"


@pytest.fixture
def scale(request):
    """Chooses between a count for every run and one for the night."""
    is_nightly = request.config.getoption("--nightly")
    return lambda smoke, nightly: nightly if is_nightly else smoke


@pytest.fixture
def figures(request, record_property):
    """Tells figures: printed for people, kept as properties of the test for `benchmarks/durability.py`."""

    def tell(**values):
        for name, value in values.items():
            record_property(name, value)
        line = ", ".join(f"{name} {value}" for name, value in values.items())
        print(f"{request.node.name}: {line}")  # noqa: T201 - for people: `pytest -s` or `-rA`

    return tell


@pytest.fixture
def memory(tmp_path):
    """A folder in memory where the system has one: the tests ask for order and content, not for the disk."""
    if not MEMORY.is_dir():
        yield tmp_path
        return
    folder = Path(tempfile.mkdtemp(prefix="durability-", dir=MEMORY))
    yield folder
    shutil.rmtree(folder)
