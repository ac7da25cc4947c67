"""The wheel carries everything that lies outside the package, and works in an empty folder."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("trees", "goal_graphs", "skills", "scenes", "robots", "protocol", "faults", "docs/howto")
KIT = ("pyproject.toml", "rollout_forecaster/forecaster.py")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True, timeout=300)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def site(wheel, tmp_path_factory):
    """An installation without the checkout: the wheel's files, and what is compiled of them already."""
    folder = tmp_path_factory.mktemp("site")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    for cache in (ROOT / "phyagentos").rglob("__pycache__"):
        place = folder / cache.relative_to(ROOT)
        if place.parent.is_dir():  # a folder of an earlier commit has a cache alone
            shutil.copytree(cache, place)
    for source in (folder / "phyagentos").rglob("*.py"):  # Python and numba know a source by its time and size
        of_checkout = ROOT / source.relative_to(folder)
        if of_checkout.exists():
            os.utime(source, ns=(of_checkout.stat().st_mtime_ns,) * 2)
    return folder


@pytest.fixture(scope="module")
def begun(site, tmp_path_factory):
    """A folder in which `paos init x` was typed."""
    folder = tmp_path_factory.mktemp("begun")
    done = paos(site, folder, "init", "x")
    assert done.returncode == 0, done.stderr
    return folder


def paos(site, folder, *arguments):
    command = [sys.executable, "-m", "phyagentos", *map(str, arguments)]
    environment = os.environ | {"PYTHONPATH": str(site)}
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=120
    )


@pytest.mark.parametrize("folder", FOLDERS)
def test_the_wheel_carries_every_authored_file(wheel, folder):
    carried = set(zipfile.ZipFile(wheel).namelist())
    shipped = [path for path in (ROOT / folder).rglob("*") if path.suffix in {".yaml", ".md", ".xml", ".json"}]
    missing = [
        name for path in shipped if f"phyagentos/share/{(name := path.relative_to(ROOT).as_posix())}" not in carried
    ]
    assert shipped
    assert not missing


def test_the_wheel_carries_a_kit_the_scaffold_the_type_marker_and_the_page(wheel):
    page = [path for folder in ("static", "templates") for path in (ROOT / "phyagentos" / "view" / folder).iterdir()]
    assert {
        *(f"phyagentos/share/kits/rollouts/{name}" for name in KIT),
        "phyagentos/operations/scaffold/goal_graphs/first.yaml",
        "phyagentos/py.typed",
        *(path.relative_to(ROOT).as_posix() for path in page),
    } <= set(zipfile.ZipFile(wheel).namelist())


def test_an_empty_folder_and_the_wheel_are_enough_to_begin(site, begun):
    linted = paos(site, begun, "lint", "x")
    assert linted.returncode == 0, linted.stderr
    named = paos(site, begun, "compile", "tidy_table")
    assert named.returncode == 0, named.stderr
    assert "Make the arm slower" in paos(site, begun, "help", "slower").stdout


def test_the_installed_package_is_used_and_not_the_checkout(site, tmp_path):
    code = "import phyagentos.protocol.capabilities.library as l; print(l.find_shipped_root())"
    environment = os.environ | {"PYTHONPATH": str(site)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == str(site / "phyagentos" / "share")


@pytest.mark.sim  # beside the others, for which the wheel is built
def test_a_new_place_runs_to_a_met_goal_from_the_wheel(site, begun):
    done = paos(site, begun, "run", "x/goal_graphs/first.yaml", "--no-pictures", "--quiet")
    assert done.returncode == 0, done.stdout + done.stderr
