"""The monitor over every workspace that a test leaves: imported by tests/conftest.py, active in journeys."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from .silence import find_violations

_judged: dict[Path, int] = {}  # log -> size when it was judged last; a warm plane's grows from test to test
_PLACES = ("logs", "*/logs", "*/*/logs", "*/*/*/logs", "*/reruns/*/logs", "*/*/reruns/*/logs")


def iter_new_workspaces(base: Path) -> Iterator[Path]:
    """Workspaces whose targets have received something since the last call."""
    for place in _PLACES:
        for log in base.glob(f"{place}/receive-*.jsonl"):
            log = log.resolve()  # pytest keeps a link to the latest of each name
            size = log.stat().st_size
            if _judged.get(log) != size:
                _judged[log] = size
                yield log.parents[1]


@pytest.fixture(autouse=True)
def silence_is_proved(request, tmp_path_factory):
    """No target accepted anything that it must not."""
    yield
    if request.node.get_closest_marker("journey") is None:
        return
    roots = set(iter_new_workspaces(tmp_path_factory.getbasetemp()))
    found = [str(violation) for root in sorted(roots) for violation in find_violations(root)]
    assert not found, "\n".join(found)
