"""Example projects are clean before anything runs."""

import pytest

from phyagentos.operations.lint import lint_paths
from phyagentos.protocol.capabilities.library import find_shipped_root

PROJECTS = find_shipped_root() / "examples" / "projects"


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["01_yaml_skill", "03_policy_server", "04_two_arms", "07_fetch_and_sort", "11_workbench"]
)
def test_an_example_lints_clean(name):
    found = lint_paths([PROJECTS / name])

    assert found.checked
    assert not found.problems
