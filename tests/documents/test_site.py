"""The pages hang together: every link leads somewhere, the menu is short, and every page can be reached from it."""

import re

import pytest

from phyagentos.cli.outcome import ExitCode

from .pages import ROOT, TEXTS, find_anchors, iter_links, name_of, read

DOCS = ROOT / "docs"
NAV = read(ROOT / "mkdocs.yml").partition("\nnav:\n")[2]
MENU = re.findall(r"[\w/]+\.md", NAV)
GROUPS = 4
MOST_ENTRIES = 17
MOST_LINES_OF_README = 150


@pytest.mark.parametrize("path", TEXTS, ids=name_of)
def test_every_link_leads_somewhere(path):
    for target, anchor in iter_links(path):
        found = (path.parent / target) if target else path
        assert found.exists(), f"{name_of(path)}: {target}"
        assert not anchor or found.suffix != ".md" or anchor in find_anchors(found), (
            f"{name_of(path)}: {target}#{anchor}"
        )


def test_the_menu_is_short_and_every_page_of_it_exists():
    assert [page for page in MENU if not (DOCS / page).is_file()] == []
    assert len(MENU) <= MOST_ENTRIES
    assert len(re.findall(r"^  - [A-Z]\w+:$", NAV, re.MULTILINE)) == GROUPS


def test_every_page_is_reached_by_links_from_the_menu():
    reached, open_ = set(), [DOCS / page for page in MENU]
    while open_:
        page = open_.pop()
        if page not in reached:
            reached.add(page)
            links = ((page.parent / target).resolve() for target, _ in iter_links(page) if target)
            open_ += [each for each in links if each.suffix == ".md" and each.is_relative_to(DOCS)]
    assert {name_of(page) for page in DOCS.rglob("*.md")} - {name_of(page) for page in reached} == set()


def test_the_readme_is_one_page():
    assert len(read(ROOT / "README.md").splitlines()) <= MOST_LINES_OF_README


def test_the_goal_graph_in_the_readme_compiles(tmp_path, paos):
    (block,) = re.findall(r"```yaml\n(goal: .*?)```", read(ROOT / "README.md"), re.DOTALL)
    path = tmp_path / "graph.yaml"
    path.write_text(block, encoding="utf-8")
    assert len(block.splitlines()) == 12
    assert paos("compile", path).code == ExitCode.GOAL_MET


@pytest.mark.parametrize("path", TEXTS, ids=name_of)
def test_no_text_names_this_package_as_one_of_a_registry(path):
    assert re.findall(r"pip install '?phyagentos", read(path)) == []


@pytest.mark.parametrize("path", [path for path in TEXTS if path.parent.name == "howto" and path.stem != "index"])
def test_a_how_to_page_is_short_begins_with_its_answer_and_has_words_that_find_it(path):
    title, blank, answer, *rest = read(path).splitlines()
    assert len(rest) <= 57
    assert title.startswith("# ")
    assert blank == ""
    assert answer
    assert not answer.startswith(("#", "|", "<", "```"))
    assert rest[-1].startswith("Also: ")
    assert f"({path.name})" in read(path.parent / "index.md")
