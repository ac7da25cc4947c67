"""The monitor over every workspace that journeys leave: imported by tests/conftest.py, active where there are any."""

from pathlib import Path

import pytest

from .silence import find_violations

_PLACES = ("logs", "*/logs", "*/*/logs", "*/*/*/logs", "*/reruns/*/logs", "*/*/reruns/*/logs")


def find_workspaces(base: Path) -> set[Path]:
    """Workspaces whose targets have received something; pytest keeps a link to the latest of each name."""
    return {log.resolve().parents[1] for place in _PLACES for log in base.glob(f"{place}/receive-*.jsonl")}


@pytest.fixture(scope="session", autouse=True)
def silence_is_proved(request, tmp_path_factory):
    """No target accepted anything that it must not: once all journeys of this process are over."""
    yield
    if any(item.get_closest_marker("journey") for item in request.session.items):
        roots = sorted(find_workspaces(tmp_path_factory.getbasetemp()))
        found = [str(violation) for root in roots for violation in find_violations(root)]
        assert not found, "\n".join(found)
