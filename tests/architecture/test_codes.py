"""The table of error codes is complete: nothing coded stands outside it, and no row of it is never raised."""

import ast
import re
from pathlib import Path

import pytest

import phyagentos
from phyagentos.codes import ALIASES, CODES, find_code, get_present_name

PACKAGE = Path(phyagentos.__file__).parent
ROLLOUTS = PACKAGE.parent / "kits" / "rollouts"  # its codes are causes of the agent
ROOT = PACKAGE.parent
FORM = re.compile(r"[A-Z][A-Z0-9]*(_[A-Z0-9]+)+|[A-Z]{4,}")
SUFFIX = re.compile(r"_[A-Z]{4,}")  # of f"{kind}_UNAVAILABLE"
OTHER_NAMES = {
    "AF_UNIX",
    "DISPLAY",
    "DRIVER_CHECKS",
    "EDITOR",
    "FLOCK",
    "LOCK_NAME",
    "MENAGERIE_ROOT",
    "MUJOCO_EGL_DEVICE_ID",
    "MUJOCO_GL",
    "OPENBLAS_NUM_THREADS",
    "PAOS_DEBUG",
    "PHYAGENTOS_ENVIRONMENTS",
    "PATH",
    "PHYAGENTOS_FLEET",
    "PHYAGENTOS_FORKED_FOR",
    "PHYAGENTOS_FORK_SERVER",
    "PHYAGENTOS_MEMORY",
    "PHYAGENTOS_MODEL",
    "PHYAGENTOS_MODELS",
    "PHYAGENTOS_MODEL_KEY",
    "PHYAGENTOS_MODEL_URL",
    "PHYAGENTOS_OUTCOMES",
    "PHYAGENTOS_ROS2_PYTHON",
    "PYOPENGL_PLATFORM",
    "PYTHON",
    "PYTHONPATH",
    "RAY_ADDRESS",
    "RGBA",
    "ROLE",
    "VISUAL",
    "WIRE_VERSION",
}  # the system's, and attributes of classes
OF_SQLITE = {"COMMIT", "DEFERRED", "IMMEDIATE", "ROLLBACK"}
METAVARS = {
    "AREA",
    "BODY",
    "FILE",
    "FOLDER",
    "GOAL",
    "GRAPH",
    "MATERIAL",
    "MODEL",
    "PREFIX",
    "PROPOSAL",
    "ROBOT",
    "SESSION",
    "TREE",
    "TYPE",
}
OF_HTTP = {"POST"}
TRACE = {"SUCCESS", "FAILURE"}  # py_trees' own words


def find_names() -> tuple[set[str], set[str]]:
    """Every upper-case constant of the package and the kit of rollouts, and the endings of those put together."""
    names, endings = set(), set()
    for path in (*PACKAGE.rglob("*.py"), *ROLLOUTS.rglob("*.py")):
        if path.name in {"codes.py", "code_tables.py"} and path.parent == PACKAGE:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                if FORM.fullmatch(node.value):
                    names.add(node.value)
                elif SUFFIX.fullmatch(node.value):
                    endings.add(node.value)
    return names - OTHER_NAMES - OF_SQLITE - METAVARS - OF_HTTP - TRACE, endings


@pytest.fixture(scope="module")
def found():
    return find_names()


@pytest.mark.slow
def test_every_code_stands_in_the_table(found):
    missing = {name for name in found[0] - set(CODES) if not any(code.startswith(name + "_") for code in CODES)}
    assert not missing, "add them to phyagentos/code_tables.py"


@pytest.mark.slow
def test_every_row_is_raised_somewhere(found):
    names, endings = found
    silent = {name for name in set(CODES) - names if not any(name.endswith(ending) for ending in endings)}
    assert not silent, "nothing raises them"


def test_a_code_is_explained_and_a_misspelt_one_gets_the_nearest():
    assert CODES["GRASP_LOST"].meaning
    assert all(code.meaning.endswith(".") for code in CODES.values())


def test_a_code_of_an_earlier_release_is_found_by_its_new_name():
    assert find_code("RECURSION") == find_code("CYCLE") == CODES["CYCLE"]
    assert get_present_name("NEVER_SEEN") == get_present_name("NOT_OBSERVED") == "NOT_OBSERVED"
    assert set(ALIASES.values()) <= set(CODES)
    assert not set(ALIASES) & set(CODES)
    assert find_code("NEVER_A_CODE") is None
