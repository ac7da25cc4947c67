"""The rules of the house that no linter knows."""

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "phyagentos"
MODULES = sorted(PACKAGE.rglob("*.py"))
OWN_PYTHON = sorted(
    path
    for folder in ("phyagentos", "tests", "examples", "benchmarks", "skills", "kits")
    for path in (ROOT / folder).rglob("*.py")
)
MAX_LINES = 600
COMPOSED = ("SessionRunner", "WorkerLoop", "Mission", "Physics")
MAX_COLLABORATORS = 8
FACADES = (PACKAGE, PACKAGE / "testing")
BANNED_STEMS = {"utils", "util", "helpers", "helper", "misc", "common"}
BODY_LIBRARIES = {"mujoco", "mink", "ompl", "toppra", "casadi", "py_trees", "numba"}


@cache
def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_no_file_is_longer_than_six_hundred_lines():
    lengths = {name_of(path): len(path.read_text(encoding="utf-8").splitlines()) for path in OWN_PYTHON}
    assert not {name: n for name, n in lengths.items() if n > MAX_LINES}, "split them by concept"


@pytest.mark.slow
def test_files_that_demand_memory_are_read_in_bounds_alone():
    unbounded = {"from_binary_path", "load"}
    owners = {"MjModel", "mujoco.MjModel", "np", "numpy"}
    bounding = {"phyagentos/pictures/model_file.py", "phyagentos/protocol/workspace/array_files.py"}
    readers = {
        name_of(path)
        for path in OWN_PYTHON
        if path.relative_to(ROOT).parts[0] in {"phyagentos", "benchmarks"}
        for node in ast.walk(parse(path))
        if isinstance(node, ast.Attribute) and node.attr in unbounded and ast.unparse(node.value) in owners
    }
    own = {"benchmarks/safety_parts/attacker.py", "benchmarks/unseen_parts/records.py"}  # what their own runs wrote
    strangers = {each for each in readers - own if not each.startswith("benchmarks/oracle/")}  # it shares no code
    assert strangers <= bounding, "read_model and read_arrays reserve no more than a file has"


def test_no_module_is_named_after_nothing():
    found = [name_of(path) for path in OWN_PYTHON if path.stem in BANNED_STEMS]
    assert not found, "put the functions next to their users"


def test_every_package_root_holds_a_docstring_only():
    for path in (path for path in MODULES if path.name == "__init__.py"):
        tree = parse(path)
        assert ast.get_docstring(tree), f"{name_of(path)}: say what the package is"
        rest = [node for node in tree.body[1:] if not (path.parent in FACADES and _loads_nothing(node))]
        assert not rest, f"{name_of(path)}: importing a package must not load anything"


def _loads_nothing(node):
    """The version, the names of the library, and what a type checker alone, or a reader of such a name, sees."""
    if isinstance(node, ast.Assign):
        return ast.unparse(node.targets[0]) in {"__version__", "__all__"}
    if isinstance(node, ast.If):
        seen = all(isinstance(each, ast.ImportFrom) for each in node.body)
        read = all(isinstance(each, ast.FunctionDef) for each in node.orelse)
        return ast.unparse(node.test) == "TYPE_CHECKING" and seen and read
    return ast.unparse(node) == "from typing import TYPE_CHECKING"


def test_importing_the_package_loads_nothing_but_itself():
    loaded = loaded_by("phyagentos") - loaded_by("typing")
    assert {name for name in loaded if name.partition(".")[0] not in sys.stdlib_module_names} == {"phyagentos"}


@pytest.mark.slow
def test_every_public_name_of_the_package_is_documented():
    silent = []
    for path in MODULES:
        tree = parse(path)
        public = [
            each for each in tree.body if isinstance(each, ast.FunctionDef | ast.ClassDef) and each.name[0] != "_"
        ]
        silent += [name_of(path)] if not ast.get_docstring(tree) else []
        silent += [f"{name_of(path)}: {node.name}" for node in public if not ast.get_docstring(node)]
    assert not silent, "no docstring"


def test_no_code_is_left_unfinished():
    words = ("TODO", "FIXME", "XXX", "HACK")
    found = [name_of(path) for path in MODULES if any(word in path.read_text(encoding="utf-8") for word in words)]
    assert not found


@pytest.mark.slow
def test_what_runs_a_session_or_a_goal_has_at_most_eight_collaborators():
    counts = {name: count_parameters(find_class(name)) for name in COMPOSED}
    assert not {name: count for name, count in counts.items() if count > MAX_COLLABORATORS}, counts


def find_class(name):
    trees = (parse(path) for path in MODULES)
    (found,) = (n for tree in trees for n in tree.body if isinstance(n, ast.ClassDef) and n.name == name)
    return found


def count_parameters(node):
    """Of the constructor, `self` left out; of a dataclass, its fields that a caller gives."""
    made = next((each for each in node.body if isinstance(each, ast.FunctionDef) and each.name == "__init__"), None)
    if made is not None:
        return len([*made.args.args, *made.args.kwonlyargs]) - 1
    fields = [each for each in node.body if isinstance(each, ast.AnnAssign)]
    return sum("init=False" not in ast.unparse(each) for each in fields)


def loaded_by(*modules: str) -> set[str]:
    """Top-level names in `sys.modules` of a fresh interpreter after importing `modules`."""
    code = f"import {', '.join(modules)}, sys; print(*sorted({{name for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    return set(done.stdout.split())


def modules_of(place: str) -> list[str]:
    """Of a package, or of one file."""
    paths = sorted((PACKAGE / place).rglob("*.py")) or [PACKAGE / place]
    names = [path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".") for path in paths]
    return [name.removesuffix(".__init__") for name in names if not name.endswith("__main__")]


AGENT, RUNTIME = "phyagentos.agent", "phyagentos.runtime"
LOADED = {  # by all modules of a room, or by one alone: what it never loads, and rooms of which it loads nothing
    "agent": (BODY_LIBRARIES, (RUNTIME,)),
    "runtime": ({"networkx"}, (AGENT,)),
    "protocol": (BODY_LIBRARIES | {"networkx"}, (AGENT, RUNTIME)),
    "cli/app.py": (BODY_LIBRARIES | {"networkx", "numpy"}, (AGENT, RUNTIME)),
}


@pytest.mark.slow
@pytest.mark.parametrize("place", LOADED)
def test_no_room_loads_a_library_or_a_plane_that_is_not_its_own(place):
    libraries, rooms = LOADED[place]
    loaded = loaded_by(*modules_of(place))
    assert not loaded & libraries
    assert not {name for name in loaded if name.startswith(rooms)}


SPEAKS = ("print", "input", "exit", "SystemExit", "redirect_stdout")
STREAMS = ("sys.stdout.write", "sys.stdout.flush", "sys.stderr.write", "sys.stderr.flush", "typer.", "click.")
STARTS = ("subprocess.Popen", "subprocess.run", "subprocess.check", "os.fork", "os.exec", "os.spawn", "os.system")
MAY_SPEAK = {
    "phyagentos/__main__.py",
    "phyagentos/assembly/agent_plane.py",  # the main of a plane: what it prints is its log
    "phyagentos/assembly/processes.py",  # the mains of workers, worlds and planners, likewise
    "phyagentos/view/scenes.py",  # keeps quiet what the server of the 3D scene prints
}
MAY_START_PYTHON = {
    "phyagentos/assembly/planes.py": "planes",
    "phyagentos/bench/episode.py": "episodes",
    "phyagentos/runtime/channel.py": "planners",
    "phyagentos/runtime/motion/process.py": "beside a planner, what compiles a half of its kernels the first time",
    "phyagentos/runtime/supervision/world_process.py": "worlds and workers",
}
MAY_START = {  # outside of the command line, which starts the editor of a person, and nodes of ROS 2
    "phyagentos/fork_server.py": "those",
    "phyagentos/bench/availability.py": "environments of others, made and looked at",
    "phyagentos/bench/sweep.py": "policies of a suite",
    "phyagentos/assembly/graphics.py": "a picture: a graphics driver that crashes must not take the report with it",
    "phyagentos/runtime/drivers/kit.py": "bodies of the kit, and environments of others",
}


@cache
def find_calls(path):
    """The names of what a module calls or raises, as they are written."""
    nodes = list(ast.walk(parse(path)))
    called = {ast.unparse(node.func) for node in nodes if isinstance(node, ast.Call)}
    return called | {ast.unparse(node.exc) for node in nodes if isinstance(node, ast.Raise) and node.exc is not None}


def find_callers(is_meant):
    found = {name_of(path): sorted({each for each in find_calls(path) if is_meant(each)}) for path in MODULES}
    return {name: calls for name, calls in found.items() if calls and not name.startswith("phyagentos/cli/")}


@pytest.mark.slow
def test_only_the_command_line_prints_prompts_and_exits():
    found = find_callers(
        lambda each: each.removeprefix("sys.").removeprefix("contextlib.") in SPEAKS or each.startswith(STREAMS)
    )
    assert {name: calls for name, calls in found.items() if name not in MAY_SPEAK} == {}


@pytest.mark.slow
def test_child_processes_are_planes_planners_worlds_episodes_and_environments_of_others():
    assert set(find_callers(lambda each: each.startswith(STARTS))) == set(MAY_START)
    assert set(find_callers(lambda each: each == "start_python")) == set(MAY_START_PYTHON)
    commands = sorted((PACKAGE / "cli").rglob("*.py"))
    assert [path.name for path in commands if any(each.startswith(STARTS) for each in find_calls(path))] == [
        "editing.py",
        "kits.py",  # becomes a node of a kit, or runs its module, in the Python of ROS 2 or LeRobot
    ]


@pytest.mark.slow
def test_files_are_utf_8_in_every_locale():
    calls = {name_of(path): [each for each in ast.walk(parse(path)) if isinstance(each, ast.Call)] for path in MODULES}
    of_text = re.compile(r"\.(read|write)_text\(")
    written = {
        name: [each for each in map(ast.unparse, nodes) if of_text.search(each)] for name, nodes in calls.items()
    }
    assert [(name, each) for name, texts in written.items() for each in texts if "encoding=" not in each] == []


def test_no_process_is_started_for_what_an_operation_does():
    """`python -m phyagentos` starts the planes, each by its name; other processes are modules of their own."""
    texts = {name_of(path): path.read_text(encoding="utf-8") for path in MODULES}
    started = {name: re.findall(r'"-m",\s*"(phyagentos[\w.]*)"', text) for name, text in texts.items()}
    assert {name: modules for name, modules in started.items() if modules} == {
        "phyagentos/assembly/planes.py": ["phyagentos"],
        "phyagentos/assembly/processes.py": ["phyagentos.assembly.worker_process", "phyagentos.assembly.processes"],
        "phyagentos/bench/episode.py": ["phyagentos.bench.episode"],
        "phyagentos/fork_server.py": ["phyagentos.fork_server"],
        "phyagentos/runtime/motion/process.py": [
            "phyagentos.runtime.motion.process",
            "phyagentos.runtime.motion.path_kernels",
        ],
    }
