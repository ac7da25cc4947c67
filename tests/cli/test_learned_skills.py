"""A sequence of sessions that has proved itself becomes a skill, and is taken out again."""

import shutil

import pytest
import yaml
from msgspec.structs import replace

from phyagentos.agent.memory.episodes import Features
from phyagentos.agent.memory.memory import Memory
from phyagentos.agent.memory.sequences import compose, find_starts
from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.registries import read_skill_registry
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.protocol.workspace.workspace import Workspace
from tests.agent.memory.conftest import make_episode

POST = Features(object="post_1", object_kind="post")
GIVEN = {"object": "cube_1", "destination": "tray_1"}
MOVED = {"object": "post_1", "support": "table", "to": [0.5, 0.1, 0.0]}
CLEAR = {"skill": "set_aside", "purpose": "clear", "parameters": MOVED}


def make_chain(number, lesson=""):
    """A first attempt that was prepared; without a lesson, after a failure."""
    failed = make_episode(ok=False, item="cube", cause="NO_PLAN", parameters=GIVEN)
    clear = replace(make_episode(parent=failed, session=f"c{number}", **CLEAR), features=POST)
    again = make_episode(parent=replace(failed, session=f"c{number}"), parameters=GIVEN)
    if not lesson:
        return [failed, clear, again]
    return [replace(clear, parent=None), replace(again, prepared=True, advised_by=(lesson,))]


@pytest.fixture
def proved(tmp_path):
    """A workspace whose memory holds a sequence, and how many more first attempts it is given."""
    workspace = Workspace.create(tmp_path / "w", Library((find_shipped_root(),)))
    memory = Memory(workspace.memory, clock=SystemClock(), by="test", durable=False)
    memory.record(make_chain(0))
    (lesson,) = memory.experience.corrections

    def prove(times):
        for number in range(1, times + 1):
            memory.record(make_chain(number, lesson))
        return workspace, memory, memory.experience.corrections[lesson]

    return prove


def make(workspace, memory, lesson):
    starts, skills = find_starts(lesson, memory.read_all()), read_skill_registry(workspace.skill_registry)
    return compose("uncover", lesson, skills, starts, memory="memory/1-a"), starts


def test_a_sequence_is_promoted_by_the_test_that_promotes_ways_and_not_before(proved):
    workspace, memory, lesson = proved(17)
    with pytest.raises(DefinitionError, match="trial after 17 of 17"):
        make(workspace, memory, lesson)
    memory.record(make_chain(99, lesson.id))
    assert make(workspace, memory, memory.experience.corrections[lesson.id])[0].skill.learned.entry == lesson.id


def test_what_is_written_lints_says_where_it_comes_from_and_can_be_taken_out(proved, paos, tmp_path):
    workspace, memory, lesson = proved(18)
    composed, starts = make(workspace, memory, lesson)
    assert len(starts) == 18
    skill, tree = tmp_path / "p" / "skills" / "uncover" / "SKILL.md", tmp_path / "p" / "trees" / "uncover.yaml"
    for path, text in ((skill, composed.render_skill()), (tree, composed.render_tree())):
        path.parent.mkdir(parents=True)
        path.write_text(text)
    assert paos("lint", skill, tree).code == 0
    learned = read_skill(skill)[0].learned
    assert (learned.entry, len(learned.sessions), learned.memory) == (lesson.id, 18, "memory/1-a")
    goal = yaml.safe_load(composed.render_goal(starts[0]))
    assert goal["sessions"]["try"]["with"] == {
        "set_aside_object": "post_1", "set_aside_support": "table", "set_aside_to": [0.5, 0.1, 0.0], **GIVEN,
    }  # fmt: skip
    assert lesson.id in paos("memory", "revoke", "uncover", "--from", tmp_path / "p").out
    assert not skill.exists()
    assert not tree.exists()


def test_a_skill_that_people_wrote_is_not_taken_out(paos, tmp_path):
    shutil.copytree(find_shipped_root() / "skills" / "pick", tmp_path / "skills" / "pick")
    assert paos("memory", "revoke", "pick", "--from", tmp_path).code == 2
    assert (tmp_path / "skills" / "pick" / "SKILL.md").exists()


def test_nothing_is_written_where_too_few_starts_are_known(proved, paos, tmp_path):
    workspace, _, lesson = proved(18)
    result = paos(
        "memory", "promote", lesson.id, "-w", workspace.root, "--name", "u", "--into", tmp_path, "--trials", 99
    )
    assert (result.code, "18 of them" in result.err) == (2, True)
    assert not (tmp_path / "skills").exists()
