"""What holds for every test: those without a marker are fast."""

import pytest

SLOW = {"sim", "motion", "journey"}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        if not SLOW & {marker.name for marker in item.iter_markers()}:
            item.add_marker(pytest.mark.fast)
