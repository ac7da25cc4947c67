"""What the README, the docs and the Makefile tell a newcomer to type exists."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from phyagentos.cli.app import GROUPS
from phyagentos.cli.outcome import ExitCode

ROOT = Path(__file__).resolve().parents[2]
TEXTS = sorted(
    [
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/*.md"),
        *ROOT.glob("examples/*/*.md"),
        *ROOT.glob("phyagentos/operations/scaffold/*.md"),
    ]
)
FENCE = re.compile(r"^```(?P<kind>\w*)\n(?P<text>.*?)^```", re.MULTILINE | re.DOTALL)
PAGES = sorted({*TEXTS, *ROOT.glob("docs/**/*.md")})
LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)#?([^)\s]*)\)")
CODE = re.compile(r"^```.*?^```|`[^`\n]*`", re.MULTILINE | re.DOTALL)
HEADING = re.compile(r"^#+ +(.+?)\s*$", re.MULTILINE)
PLACEHOLDERS = {"GRAPH", "SESSION", "FILE…", "DIR"}


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


QUOTED = re.compile(r"\"[^\"]*\"|'[^']*'")  # what another program is told


def iter_commands(path: Path) -> list[str]:
    text = path.read_text(encoding="utf-8")
    fenced = [
        line[2:] for fence in FENCE.finditer(text) for line in fence["text"].splitlines() if line.startswith("$ ")
    ]
    inline = re.findall(r"`(paos [^`]+)`", text)
    return [command.split("#")[0].strip() for command in (*fenced, *inline)]


@pytest.mark.parametrize("path", TEXTS, ids=name_of)
def test_every_command_in_the_texts_exists(path, paos):
    for command in iter_commands(path):
        for part in re.split(r"&&|\|", QUOTED.sub("", command)):
            words = part.split()
            if words[:1] == ["make"]:
                targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
                assert words[1] in targets, f"{name_of(path)}: {part}"
            elif words[:1] == ["paos"] and len(words) > 1 and not words[1].startswith("-"):
                depth = 3 if words[1] in GROUPS and len(words) > 2 else 2
                usage = paos(*words[1:depth], "--help")
                assert usage.code == ExitCode.GOAL_MET, f"{name_of(path)}: {part}"
                for option in re.findall(r"(?<=\s)--?[a-z][a-z-]*", part):
                    assert option in usage.out, f"{name_of(path)}: {part}: no option {option}"


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_every_link_leads_somewhere(path):
    for target, anchor in LINK.findall(CODE.sub("", path.read_text(encoding="utf-8"))):
        found = (path.parent / target) if target else path
        assert found.exists(), f"{name_of(path)}: {target}"
        assert not anchor or found.suffix != ".md" or anchor in find_anchors(found), (
            f"{name_of(path)}: {target}#{anchor}"
        )


def find_anchors(path):
    """Of its headings, as GitHub and the site make them."""
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    words = (re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower() for heading in HEADING.findall(text))
    return {re.sub(r"[^\w\- ]", "", each).strip().replace(" ", "-") for each in words}


def test_every_page_stands_in_the_menu_of_the_site():
    menu = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("nav:")[2]
    pages = {path.relative_to(ROOT / "docs").as_posix() for path in ROOT.glob("docs/**/*.md")}
    assert set(re.findall(r"[\w/]+\.md", menu)) == pages


def test_the_graph_in_the_readme_is_the_graph_that_ships(paos):
    drawn = paos("compile", ROOT / "goal_graphs/tidy_table.yaml", "--mermaid").out
    assert drawn.strip() in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
@pytest.mark.parametrize("target", ["setup", "demo", "test", "test-extras", "check", "schemas", "site", "wheel"])
def test_make_knows_what_it_would_do(target):
    done = subprocess.run(["make", "--dry-run", target], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
