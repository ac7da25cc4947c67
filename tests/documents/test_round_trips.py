"""What a document is rendered from is what a reader gets back, and its JSON Schema agrees."""

import msgspec
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from phyagentos.protocol.capabilities.registries import read_target, render_skills, render_targets
from phyagentos.protocol.capabilities.skill_runtimes import SKILLRUNTIME, Needs, Output, Parameter, SkillRuntime
from phyagentos.protocol.capabilities.targets import TARGETS, Health, RegisteredTarget, TargetHealth
from phyagentos.protocol.documents.document import read_document
from phyagentos.protocol.documents.log import LogLine, read_log
from phyagentos.protocol.predicates.relations import compute_relations
from phyagentos.protocol.sessions.knowledge import KNOWLEDGE, Fact, render_knowledge
from phyagentos.protocol.sessions.lessons import LESSONS, Lesson, render_lessons
from phyagentos.protocol.sessions.runtime_signal import RUNTIME_SIGNAL, RuntimeState, Signs
from phyagentos.protocol.sessions.session import SESSIONS, Session, SessionStatus
from phyagentos.protocol.sessions.tasks import TASK, GoalStatus
from phyagentos.protocol.world.environment import (
    Entity,
    Environment,
    Interior,
    Pose,
    Shape,
    ShapeKind,
    read_environment,
)
from phyagentos.store.ledger import Ledger
from phyagentos.store.runtime_signal import render_runtime_signal
from phyagentos.store.views.environment import render_environment
from phyagentos.store.views.log import render_log
from phyagentos.store.views.sessions import Page, render_page
from phyagentos.store.views.tasks import render_tasks

from .values import NAMES, NUMBERS, TEXTS, WHOLE, check_schema, draw, draw_struct

pytestmark = pytest.mark.slow

FEW = settings(
    max_examples=12,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    phases=[Phase.explicit, Phase.reuse, Phase.generate],  # the values are large: shrinking them takes minutes
)
STATES = st.sampled_from(["pending", "running", "succeeded", "failed", "replanned", "rejected"])
STATUSES = draw_struct(SessionStatus, contract=draw_struct(Session, id=NAMES), state=STATES)
GOALS = draw_struct(GoalStatus, id=NAMES)
SIZES = {ShapeKind.BOX: 3, ShapeKind.CYLINDER: 2, ShapeKind.CAPSULE: 2, ShapeKind.SPHERE: 1}
POINTS = st.tuples(*[st.floats(-2, 2)] * 3)
POSES = st.builds(Pose, position_m=POINTS)
SHAPES = st.sampled_from(list(SIZES)).flatmap(
    lambda kind: st.builds(Shape, kind=st.just(kind), size_m=st.tuples(*[st.floats(0.01, 1)] * SIZES[kind]), pose=POSES)
)
INTERIORS = st.none() | st.builds(Interior, center_m=POINTS, half_m=st.tuples(*[st.floats(0.01, 1)] * 3))
ENTITIES = draw_struct(
    Entity, name=NAMES, pose=POSES, shapes=st.lists(SHAPES, max_size=2).map(tuple), interior=INTERIORS
)
ENVIRONMENTS = draw_struct(
    Environment, entities=st.lists(ENTITIES, max_size=3).map(lambda each: {entity.name: entity for entity in each})
)
PARAMETERS = st.builds(
    lambda ends, unit: Parameter(type="number", unit=unit, minimum=min(ends), default=max(ends)),
    st.tuples(NUMBERS, NUMBERS),
    TEXTS,
)
SKILLS = st.builds(
    SkillRuntime,
    skill=st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True),
    description=TEXTS,
    tree=TEXTS,
    parameters=st.dictionaries(NAMES, PARAMETERS, max_size=2),
    outputs=st.dictionaries(NAMES, st.builds(Output, type=st.just("point"), description=TEXTS), max_size=2),
    guarantees=st.lists(TEXTS, max_size=2).map(tuple),
    needs=st.builds(Needs, capabilities=st.lists(TEXTS, max_size=2).map(tuple)),
)
HEALTH = st.builds(TargetHealth, state=st.sampled_from(list(Health)), since=TEXTS, session=TEXTS)
LINES = st.builds(
    LogLine,
    at=st.builds("2026-11-{:02}T{:02}:{:02}:59Z".format, st.integers(1, 30), st.integers(0, 23), st.integers(0, 59)),
    about=NAMES,
    by=NAMES,
    text=TEXTS.map(lambda text: " ".join(text.split())),
)


def index(values):
    return {value.id: value for value in values}


SIGNS = draw(Signs).filter(lambda signs: signs.runtime is not RuntimeState.NOT_STARTED)
DOCUMENTS = {  # file -> blocks by their names, and what renders them
    SKILLRUNTIME: (
        st.lists(SKILLS, max_size=3).map(lambda skills: {skill.skill: skill for skill in skills}),
        lambda blocks: render_skills(list(blocks.values())),
    ),
    LESSONS: (
        st.lists(draw_struct(Lesson, id=NAMES), max_size=3).map(index),
        lambda blocks: render_lessons(blocks.values()),
    ),
    KNOWLEDGE: (
        st.lists(draw_struct(Fact, id=NAMES), max_size=3).map(index),
        lambda blocks: render_knowledge(blocks.values()),
    ),
    RUNTIME_SIGNAL: (SIGNS.map(lambda signs: {"Signs": signs}), lambda blocks: render_runtime_signal(blocks["Signs"])),
}


@FEW
@given(data=st.data())
@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.file)
def test_the_blocks_of_a_document_come_back_as_they_were(document, data):
    values, render = DOCUMENTS[document]
    blocks = data.draw(values)
    text = render(blocks)
    found = read_document(text, document).blocks
    assert (found, list(found)) == (blocks, list(blocks))
    check_schema(text, document.file)


@FEW
@given(st.lists(STATUSES, max_size=3), WHOLE)
def test_sessions_come_back_as_they_were(statuses, seq):
    statuses = {status.contract.id: status for status in statuses}
    text = render_page(Page(seq, list(statuses.values()), len(statuses)))
    found = read_document(text, SESSIONS)
    assert (found.front.view, found.blocks) == (seq, statuses)
    check_schema(text, "SESSIONS.md")


@FEW
@given(st.lists(GOALS, max_size=3).map(index), WHOLE)
def test_tasks_come_back_as_they_were(goals, seq):
    ledger = Ledger()
    ledger.seq, ledger.goals = seq, goals
    text = render_tasks(ledger)
    found = read_document(text, TASK)
    assert (found.front.view, found.blocks, list(found.blocks)) == (seq, goals, list(reversed(goals)))
    check_schema(text, "TASK.md")


@pytest.fixture(scope="module")
def panda(root):
    return read_target(root / "robots" / "panda" / "target.yaml").model_dump()


@FEW
@given(health=HEALTH, description=TEXTS, width_m=st.floats(0.0, 1.0, exclude_min=True))
def test_targets_come_back_as_they_were(panda, health, description, width_m):
    gripper = panda["gripper"] | {"max_width_m": width_m}
    target = RegisteredTarget.model_validate(
        panda | {"description": description, "gripper": gripper, "health": health.model_dump()}
    )
    text = render_targets([target])

    assert read_document(text, TARGETS).blocks == {"panda": target}
    check_schema(text, "TARGETS.md")


@FEW
@given(ENVIRONMENTS)
def test_the_environment_comes_back_as_it_was(environment):
    text = render_environment(environment)
    found = read_environment(text)

    assert {name: getattr(found, name) for name in Environment.__struct_fields__} == msgspec.structs.asdict(environment)
    assert found.relations == compute_relations(environment)
    check_schema(text, "ENVIRONMENT.md")


@FEW
@given(st.lists(LINES, max_size=6), WHOLE, WHOLE)
def test_log_lines_come_back_as_they_were(lines, seq, older):
    text = render_log(lines, seq, older=older)
    found = read_log(text)

    assert (found.front.view, found.front.older) == (seq, older)
    assert list(found.lines) == lines
    check_schema(text, "LOG.md")
