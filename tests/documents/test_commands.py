"""What the pages tell a reader to type exists, and what costs little is run as it stands there."""

import functools
import re
import shlex
import subprocess
from importlib.util import find_spec

import pytest

from phyagentos.cli.app import GROUPS
from phyagentos.cli.outcome import ExitCode
from tests.stored_workspace import unpack_stored

from .pages import ROOT, TEXTS, iter_blocks, iter_inline_commands, name_of, read

FOLDERS = ("benchmarks", "docs", "examples", "faults", "goal_graphs", "kits", "protocol", "robots", "scenes", "tools")
PAGES = [path for path in TEXTS if "examples" not in path.parts]  # those are run by tests/examples
RUN = [path for path in PAGES if any(not block.why_not_run for block in iter_blocks(path))]
SHELL = {"mkdir", "cp", "export"}
QUOTED = re.compile(r"\"[^\"]*\"|'[^']*'")  # what another program is given
TARGETS = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)


@pytest.fixture
def usage(paos):
    return functools.cache(lambda *words: paos(*words, "--help"))


@pytest.mark.parametrize("path", TEXTS, ids=name_of)
def test_every_command_on_a_page_exists(path, usage):
    fenced = (command for block in iter_blocks(path) for command in block.commands)
    for command in (*fenced, *iter_inline_commands(path)):
        for part in re.split(r"&&|\||;", QUOTED.sub("", command)):
            check_part(part.split(), f"{name_of(path)}: {part}", usage)


def check_part(words, where, usage):
    while words and re.fullmatch(r"[A-Z_]+=\S*", words[0]):  # a variable for one command
        words = words[1:]
    if words[:1] == ["make"]:
        assert words[1] in TARGETS or words[1].startswith("build/"), where
    elif words[:1] == ["paos"] and len(words) > 1 and not words[1].startswith("-"):
        shown = usage(*words[1 : 3 if words[1] in GROUPS and len(words) > 2 else 2])
        assert shown.code == ExitCode.GOAL_MET, where
        for option in words[2:]:
            if re.fullmatch(r"--?[a-z][a-z-]*", option):
                assert re.search(rf"(?<![\w-]){option}(?![\w-])", shown.out), f"{where}: no option {option}"
    elif words[:1] == ["python"] and words[1:2] == ["-m"]:
        assert words[2].partition(".")[0] not in {"phyagentos", "benchmarks", "tests"} or find_spec(words[2]), where
    elif words[:1] == ["python"] and words[1:] and words[1].startswith(("benchmarks/", "tools/", "examples/")):
        assert (ROOT / words[1]).is_file(), where


@pytest.mark.parametrize("path", TEXTS, ids=name_of)
def test_the_tests_that_a_mark_names_run_the_commands_of_its_block(path):
    """`<!-- not run: …; tests/x runs it -->`: there is such a test, and it has the commands' words."""
    for block in iter_blocks(path):
        places = [ROOT / place for place in re.findall(r"tests/[\w/.]*\w", block.why_not_run)]
        files = [file for place in places for file in (sorted(place.rglob("*.py")) if place.is_dir() else [place])]
        text = "\n".join(map(read, files))
        for command in (each for each in block.commands if files and each.startswith("paos ")):
            group, *rest = command.split()[1:]
            word = rest[0] if group in GROUPS else group
            assert re.search(rf"\b{re.escape(word)}\b", text), f"{name_of(path)}: no test in {places} has `{command}`"


@pytest.mark.slow
@pytest.mark.parametrize("path", RUN, ids=name_of)
def test_what_a_page_tells_to_type_is_run(path, paos, tmp_path, monkeypatch):
    """Every block without the mark `<!-- not run: … -->` before it, in one folder, with the run of the pages in W."""
    monkeypatch.chdir(tmp_path)
    for name in FOLDERS:
        (tmp_path / name).symlink_to(ROOT / name)
    commands = [command for block in iter_blocks(path) if not block.why_not_run for command in block.commands]
    if any(re.search(r"\bW\b|workspaces/demo", command) for command in commands):
        (tmp_path / "workspaces").mkdir()
        (tmp_path / "W").symlink_to(unpack_stored(tmp_path).rename(tmp_path / "workspaces" / "demo"))
    for command in commands:
        for part in command.split("&&"):
            name, *arguments = shlex.split(part.split(" > ")[0])
            if name == "paos":
                done = paos(*arguments)
                assert done.code == ExitCode.GOAL_MET, f"{part}: {done.out}{done.err}"
            else:
                assert name in SHELL, f"{part}: mark the block `<!-- not run: REASON -->`"
                subprocess.run(part, shell=True, check=True, cwd=tmp_path)
