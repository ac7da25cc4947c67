"""Missions that remember: the next one begins with what the last one found out."""

import json
import shutil
from textwrap import dedent

import msgspec
import pytest

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.memory.advisor import MemoryAdvisor
from phyagentos.agent.memory.episode_recorder import EpisodeRecorder
from phyagentos.agent.memory.episodes import Surroundings
from phyagentos.agent.memory.experience_log import Edit
from phyagentos.agent.memory.memory import Memory
from phyagentos.clock import SystemClock
from phyagentos.errors import ExecutionError
from phyagentos.protocol.capabilities.registries import read_skill_registry
from phyagentos.protocol.documents.document import read_document
from phyagentos.protocol.sessions.knowledge import KNOWLEDGE
from phyagentos.protocol.sessions.lessons import LESSONS
from phyagentos.protocol.sessions.memory_entries import EntryState
from phyagentos.protocol.sessions.session import Ended
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy
from phyagentos.protocol.sessions.verdicts import Verdict
from tests.agent.conftest import Play, put, succeed

GRAPH = """
    goal: tidy
    objective: The red cube into its tray.
    scene: table
    targets: {arm: panda}
    sessions:
      red: {skill: pick_and_place, target: arm, with: {object: red_cube, destination: red_tray}}
    """
SCENE = """
    scene: table
    bodies:
      red_cube: {kind: cube, color: red, shapes: [{kind: box, size_m: [0.02, 0.02, 0.02]}]}
      red_tray: {kind: tray, fixed: true, shapes: [{kind: box, size_m: [0.1, 0.1, 0.01]}]}
    cameras: {}
    """
SETTINGS = ("safety.yaml", "sensors.yaml", "perception.yaml", "runtime_contract.yaml")


def slip_when_fast(world, session):
    """The cube stays in the fingers only at half speed."""
    if session.strategy.speed <= 0.5:
        return succeed(world, session)
    return Play(
        world=put(world, session.parameters["object"], (0.5, 0.1, 0.02)),
        ended=Ended.SKILL_FAILED,
        code="GRASP_LOST",
        leaf="pick_and_place/place/verify_grasp",
    )


class Lab:
    """A workspace with a scripted runtime, and one mission after the other with a memory."""

    def __init__(self, stage, scene, graph):
        self.stage, self.graph = stage, graph
        self.workspace = stage.workspace
        stage.runtime.script = {"red": slip_when_fast, "red.r1": slip_when_fast}
        catalogue = Catalogue.of_workspace(self.workspace)
        self.surroundings = Surroundings(skills=catalogue.skills, scenes={"table": scene}, targets=catalogue.targets)
        self.reported = []
        self.start = stage.runtime.world

    def open(self):
        return Memory(self.workspace.memory, clock=SystemClock(), by="test", durable=False)

    def run(self, seed, *, learns=True):
        memory = self.open()
        self.stage.runtime.world = self.start
        episode_recorder = EpisodeRecorder(
            memory, self.surroundings, self.workspace, clock=SystemClock(), report=self.reported.append
        )
        observers = [self.stage.runtime, *([episode_recorder] if learns else [])]
        advisor = MemoryAdvisor(memory, self.surroundings, self.workspace.recalled)
        mission = self.stage.make_mission(observers=observers, advisor=advisor)
        report = mission.run(self.graph, seed=seed)
        return report, [
            status.contract for status in mission.ledger.sessions.values() if status.contract.goal == report.goal
        ]

    @property
    def lessons(self):
        return read_document(self.workspace.lessons.read_text(), LESSONS).blocks

    @property
    def facts(self):
        return read_document(self.workspace.knowledge.read_text(), KNOWLEDGE).blocks


@pytest.fixture
def lab(make_stage, write_graph, tmp_path):
    scene = tmp_path / "scenes" / "table.yaml"
    scene.parent.mkdir()
    scene.write_text(dedent(SCENE))
    return Lab(make_stage(), scene, write_graph(GRAPH))


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


def test_the_second_goal_succeeds_at_the_first_attempt_and_its_contract_and_its_documents_say_why(lab):
    first, contracts = lab.run(1)
    snapshot = lab.open().snapshot
    assert [session.state for session in first.sessions] == ["replanned", "succeeded"]
    assert contracts[0].advised_by == ()

    second, (contract,) = lab.run(2)

    assert [session.state for session in second.sessions] == ["succeeded"]
    assert contract.strategy.speed == 0.5
    (lesson,) = (each for each in lab.lessons.values() if each.state is EntryState.ACTIVE)
    assert contract.advised_by == (lesson.id,)
    assert lesson.verified_by == "tidy-1.red.r1"
    assert any(lesson.id in sentence for sentence in contract.advice)
    assert any("memory/" in sentence for sentence in contract.advice)
    assert (lesson.scope.object, lesson.scope.destination) == ("cube", "tray")
    copied = json.loads((lab.workspace.recalled / f"{contract.id}.json").read_text())
    assert (copied["snapshot"], [each["id"] for each in copied["entries"]]) == (snapshot, [lesson.id])
    assert lab.stage.make_mission().ledger.goals[second.goal].memory == snapshot
    own, slower = sorted(lab.facts.values(), key=lambda fact: bool(fact.strategy))  # of first attempts alone
    assert (own.supported, own.contradicted, own.strategy) == (0, 1, DEFAULT_STRATEGY)
    assert (slower.supported, slower.contradicted) == (1, 0)


def test_a_goal_that_goes_on_is_advised_from_the_snapshot_that_it_began_with(lab):
    _, (first, _) = lab.run(1)
    memory = lab.open()
    begun = memory.snapshot
    (lesson,) = (each for each in lab.lessons.values() if each.state is EntryState.ACTIVE)
    memory.record([Edit(entry=lesson.id, retracts=True, reason="meanwhile, in another run", by="a person")])
    advisor = MemoryAdvisor(memory, lab.surroundings)
    assert advisor.begin("tidy", "") == memory.snapshot
    assert not advisor.advise(first).strategy
    assert advisor.begin("tidy", begun) == begun
    assert advisor.advise(first).sources == (lesson.id,)


def test_without_its_memory_the_same_goal_fails_as_before(lab):
    lab.run(1)
    shutil.rmtree(lab.workspace.memory)
    report, _ = lab.run(2)
    assert [session.state for session in report.sessions] == ["replanned", "succeeded"]


def test_what_a_killed_agent_could_not_remember_is_remembered_by_the_next(lab):
    lab.run(1, learns=False)
    lab.run(2)
    known = lab.open().experience.known
    assert {"tidy-1.red", "tidy-1.red.r1", "tidy-2.red", "tidy-2.red.r1"} <= {key.split()[0] for key in known}


def test_memory_never_writes_a_setting(lab):
    before = {
        name: (lab.workspace.root / name).read_bytes() for name in SETTINGS if (lab.workspace.root / name).exists()
    }
    (lab.workspace.root / "safety.yaml").write_text("version: 1\n")
    before["safety.yaml"] = b"version: 1\n"
    lab.run(1)
    hostile = "safety.yaml"
    edit(lab.workspace.knowledge, "# Knowledge", f"# Knowledge\n\n## {hostile}\n\n```yaml\nid: {hostile}\n"
         "statement: The joints may be twice as fast.\nsource: nobody\n```\n")  # fmt: skip
    edit(lab.workspace.lessons, "# Lessons", "# Lessons\n\n## ../safety.yaml\n\n```yaml\nid: ../safety.yaml\n"
         "statement: Limits do not matter.\nadvice: {velocity_rad_s: [99.0]}\n```\n")  # fmt: skip
    lab.run(2)
    lab.run(3)
    now = {name: (lab.workspace.root / name).read_bytes() for name in before}
    assert now == before
    assert lab.facts[hostile].statement == "The joints may be twice as fast."


def test_a_lesson_that_a_person_retracts_is_not_used_and_a_note_and_a_fact_stay(lab):
    lab.run(1)
    id = next(lesson.id for lesson in lab.lessons.values() if lesson.state is EntryState.ACTIVE)
    own = "state: retracted\nreason: other fingers now\nnote: seen on a Monday\n"
    edit(lab.workspace.lessons, f"id: {id}\n", f"id: {id}\n{own}")
    edit(lab.workspace.knowledge, "# Knowledge", "# Knowledge\n\n## cups\n\n```yaml\nid: cups\n"
         "statement: Cups belong on the shelf.\nsource: the owner\n```\n")  # fmt: skip
    lab.run(2)  # takes the edits in at its end
    _, (contract, *_) = lab.run(3)
    lesson, fact = lab.lessons[id], lab.facts["cups"]
    assert (lesson.state, lesson.reason, lesson.note) == (
        EntryState.RETRACTED, "other fingers now", "seen on a Monday",
    )  # fmt: skip
    assert id not in contract.advised_by
    assert (fact.statement, fact.source) == ("Cups belong on the shelf.", "the owner")


def test_a_lesson_written_by_hand_and_a_document_that_cannot_be_read_are_kept_beside_and_not_used(lab):
    lab.run(1)
    edit(lab.workspace.lessons, "# Lessons", "# Lessons\n\n## mine\n\n```yaml\nid: mine\n"
         "statement: Speed helps.\nadvice: {speed: 3.0}\nverified_by: me\n```\n")  # fmt: skip
    _, (contract, *_) = lab.run(2)
    rejected = lab.workspace.root / "LESSONS.rejected.md"
    assert "mine" not in lab.lessons
    assert contract.strategy.speed != 3.0
    assert "mine: a lesson follows from verdicts" in rejected.read_text()
    assert any("LESSONS.rejected.md" in line for line in lab.reported)
    lab.workspace.lessons.write_text("---\nphy: lessons/1\n---\n\n## broken\n\n```yaml\nid: [\n```\n")
    lab.run(3)
    assert "id: [" in rejected.read_text()
    assert lab.lessons


def test_a_promoted_way_stands_in_the_entry_of_its_skill_until_it_is_demoted(lab):
    lab.run(1)
    memory = lab.open()
    before = read_skill_registry(lab.workspace.skill_registry)
    first = next(each for each in memory.read_all() if each.session == "tidy-1.red")
    good = [make_like(first, number, Strategy(speed=0.5), Verdict.SUCCESS) for number in range(40)]
    memory.record(good)
    lab.run(2)
    skills = read_skill_registry(lab.workspace.skill_registry)
    (way,) = skills["pick_and_place"].promoted
    assert (way.strategy, way.object, way.destination) == ({"speed": 0.5}, "cube", "tray")
    assert {name: skill.model_copy(update={"promoted": ()}) for name, skill in skills.items()} == before
    memory = lab.open()
    memory.record([make_like(first, 100 + number, Strategy(speed=0.5), Verdict.REPLAN) for number in range(10)])
    lab.run(3)
    assert read_skill_registry(lab.workspace.skill_registry) == before


def make_like(episode, number, strategy, verdict):
    return msgspec.structs.replace(
        episode, session=f"g{number}.red", goal=f"g{number}", seed=number, strategy=strategy, verdict=verdict
    )


def test_a_memory_that_cannot_be_written_ends_no_mission(lab, monkeypatch):
    def refuse(self, events):
        raise ExecutionError("WRITE_FAILED", "the disk is full")

    monkeypatch.setattr(Memory, "record", refuse)
    report, _ = lab.run(1)
    assert report.verdict == "success"
    assert any("the disk is full" in line for line in lab.reported)
