"""Example 2: a package of new leaves, installed as anybody would, found through its entry points."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples" / "projects" / "02_leaf_package"
INSTALL = ["-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--target"]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Environment of a machine on which the package is installed."""
    pytest.importorskip("hatchling")
    site = tmp_path_factory.mktemp("site")
    source = tmp_path_factory.mktemp("source") / "package"
    subprocess.run(["cp", "-r", str(EXAMPLE), str(source)], check=True)  # building must not litter the checkout
    subprocess.run([sys.executable, *INSTALL, str(site), str(source)], check=True, timeout=120)
    return os.environ | {"PYTHONPATH": str(site), "PIP_NO_INDEX": "1"}


def paos(environment, folder, *arguments):
    command = [sys.executable, "-m", "phyagentos", *map(str, arguments)]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=120
    )


@pytest.mark.slow
def test_its_graph_skill_tree_and_leaf_are_found(installed, tmp_path):
    compiled = paos(installed, tmp_path, "compile", "nearest")
    assert compiled.returncode == 0, compiled.stderr
    assert "first: tidy_nearest(" in compiled.stdout


@pytest.mark.slow
def test_its_files_lint_clean_where_it_is_installed(installed, tmp_path):
    linted = paos(installed, tmp_path, "lint", EXAMPLE)
    assert linted.returncode == 0, linted.stderr


@pytest.mark.slow
def test_where_it_is_not_installed_its_leaf_is_an_unknown_name(tmp_path):
    tree = EXAMPLE / "nearest_first/library/trees/tidy_nearest.yaml"
    linted = paos(os.environ.copy(), tmp_path, "lint", tree)
    assert linted.returncode == 2
    assert "UNKNOWN_NAME (leaf): found 'choose_nearest'" in linted.stderr
