"""Documents of 0.1.x become drafts; every field that is left behind is named once, and nothing is half imported."""

from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from phyagentos.errors import DefinitionError
from phyagentos.protocol.legacy.conversion import convert
from phyagentos.protocol.legacy.documents import read_documents
from phyagentos.protocol.legacy.fields import KINDS, No, iter_rows, render_tables
from phyagentos.protocol.legacy.remarks import RemarkKind
from phyagentos.protocol.predicates.predicate import View, parse_predicate
from phyagentos.protocol.schema import read_yaml
from phyagentos.protocol.verdicts import Truth

FIXTURE = Path(__file__).parent / "legacy_fixtures" / "old"
DOCS = Path(__file__).resolve().parents[2] / "docs" / "import.md"
SESSION = {
    "session_id": "s1",
    "target_ref": "target://arm",
    "skillruntime_ref": "skillruntime://pick",
    "task_description": "pick it up",
}


@pytest.fixture
def write(tmp_path):
    def write(data, name="SESSIONS.md"):
        path = tmp_path / "old" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        text = data if isinstance(data, str) else yaml.safe_dump(data, sort_keys=False)
        path.write_text(f"# Runtime\n\n```yaml\n{text}```\n" if name.endswith(".md") else text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def sessions(write):
    def sessions(*entries):
        return write({"version": "runtime_sessions_v1", "sessions": [SESSION | entry for entry in entries]})

    return sessions


def draft_of(*paths):
    return convert(read_documents(paths))


def node_of(draft, graph="imported", node="s1"):
    return yaml.safe_load(draft.files[f"goal_graphs/{graph}.yaml"])["sessions"][node]


def problems_of(*paths):
    with pytest.raises(DefinitionError) as caught:
        draft_of(*paths)
    return caught.value.problems


@pytest.fixture(scope="module")
def old():
    return draft_of(FIXTURE)


def test_a_pending_session_becomes_a_node(old):
    node = node_of(old, "tidy_kitchen", "sess_20260801_001")

    assert node == {
        "objective": "pick up the red mug: put it on the tray",
        "skill": "pi05_libero_remote",
        "target": "libero_real_remote",
        "accept": ["unstated()"],
        "timeout_s": 300.0,
        "max_replans": 1,
        "priority": 1,
    }


def test_what_waits_for_a_pending_session_still_waits_for_it(old):
    assert node_of(old, "tidy_kitchen", "sess_20260801_002")["after"] == ["sess_20260801_001"]
    [told] = [each for each in old.remarks if each.field == "depends_on"]
    assert told.kind is RemarkKind.NOT_MAPPED
    assert told.address == f"{FIXTURE}/SESSIONS.md:42:37"
    assert "never verified" in told.reason


def test_criteria_in_prose_stand_above_the_node_as_comments(old):
    text = old.files["goal_graphs/tidy_kitchen.yaml"]
    assert "  #   success_criteria: the red mug is on the tray\n" in text
    assert "  #   constraints: no other thing has moved\n" in text


def test_what_nobody_stated_is_never_a_success():
    view = View(now=None)
    for text in ("unstated()", "not unstated()"):
        evaluation = parse_predicate(text).evaluate(view)
        assert evaluation.truth is Truth.UNKNOWN
        assert "write a predicate" in evaluation.because


def test_the_control_rate_of_a_contract_reaches_its_target(old):
    profile = yaml.safe_load(old.files["robots/libero_real_remote/target.yaml"])
    assert (profile["control_period_s"], profile["embodiment"], profile["kind"]) == (0.05, "franka_panda", "simulation")


def test_a_rate_that_no_physics_step_divides_is_told(write):
    path = write(
        "version: runtime_target_contract_v1\ntarget_id: arm\naction_contract: {control_hz: 30}\nsafety: {}\n", "c.yaml"
    )
    registry = write({"version": "runtime_target_registry_v1", "targets": [{"id": "arm"}]}, "TARGETS.md")
    draft = draft_of(registry, path)

    assert "control_period_s" not in draft.files["robots/arm/target.yaml"]
    [told] = [each for each in draft.remarks if each.kind is RemarkKind.NOT_MAPPED]
    assert (told.address, told.field) == (f"{path}:3:19", "action_contract.control_hz")


def test_finished_and_unfinished_sessions_become_history_and_no_node(old):
    assert (old.pending, old.past) == (3, 3)
    assert "Claimed by the old system, **not verified**" in old.history
    assert "| sess_20260731_009 | succeeded |" in old.history
    assert "| sess_20260731_011 | running (unfinished) |" in old.history
    assert "SESSION_TIMEOUT" in old.history
    assert not any("sess_20260731" in text for text in old.files.values())


def test_history_keeps_every_field_also_one_that_nobody_knows(sessions, write):
    entry = SESSION | {"status": "failed", "moood": {"a": [1, "```", None]}, "result": {"error_code": "ADAPTER"}}
    draft = draft_of(write({"version": "runtime_sessions_v1", "sessions": [entry]}))
    block = draft.history.split("yaml\n", 1)[1].rsplit("````", 1)[0]

    assert yaml.safe_load(block) == entry
    assert [(each.kind, each.field) for each in draft.remarks] == [(RemarkKind.UNKNOWN, "moood")]


def test_every_field_of_the_schema_that_is_not_read_is_reported_with_its_place(old):
    told = {(each.address, each.field) for each in old.remarks}
    assert (f"{FIXTURE}/SESSIONS.md:20:16", "timeouts.queue_timeout_s") in told
    assert (f"{FIXTURE}/TARGETS.md:11:5", "workspace") in told
    assert (f"{FIXTURE}/SKILLRUNTIME.md:12:5", "policy") in told
    assert (f"{FIXTURE}/configs/runtime/contracts/libero.contract.yaml:22:3", "safety.gripper_range") in told
    unknown = [(each.address, each.field) for each in old.remarks if each.kind is RemarkKind.UNKNOWN]
    assert unknown == [
        (f"{FIXTURE}/SESSIONS.md:48:5", "favourite_colour"),
        (f"{FIXTURE}/SESSIONS.md:69:5", "moood"),
    ]


def read_leaves(value, table, path=()):
    """Dotted names of the fields of an entry, as deep as the table goes."""
    for key, inner in value.items():
        field = table.get(key)
        if isinstance(field, dict) and isinstance(inner, dict):
            yield from read_leaves(inner, field, (*path, key))
        else:
            yield ".".join((*path, key)), field


def test_no_field_of_a_pending_session_is_passed_over_in_silence(old):
    table = KINDS["runtime_sessions_v1"].fields
    located = read_documents([FIXTURE / "SESSIONS.md"])[0].located
    for index, entry in enumerate(located.data["sessions"]):
        if entry["status"] != "pending":
            continue
        for name, field in read_leaves(entry, table):
            at = located.address_of(("sessions", index, *name.split(".")))
            told = [each for each in old.remarks if (each.address, each.field) == (at, name)]
            told = [each for each in told if each.kind in {RemarkKind.IGNORED, RemarkKind.UNKNOWN}]
            assert len(told) == (1 if field is None or isinstance(field, No) else 0), name


def test_the_page_prints_the_table_of_fields():
    assert render_tables() in DOCS.read_text(encoding="utf-8")
    assert all(len({name for name, _ in iter_rows(kind.fields)}) > 3 for kind in KINDS.values())


KEYS = st.text(st.characters(categories=("L", "N", "P", "S", "Zs")), min_size=1, max_size=12)
PLACES = {
    "SESSIONS.md": ((), ("timeouts",), ("retry",), ("routing",), ("execution",), ("verification",), ("runtime_hints",)),
    "TARGETS.md": ((), ("runtime",)),
    "c.yaml": ((), ("action_contract",), ("safety",)),
}


def build_documents():
    session = SESSION | {key[0]: {} for key in PLACES["SESSIONS.md"] if key}
    target = {"id": "arm", "target_kind": "simulation", "runtime": {}}
    contract = {"version": "runtime_target_contract_v1", "target_id": "arm", "action_contract": {}, "safety": {}}
    documents = {
        "SESSIONS.md": {"version": "runtime_sessions_v1", "sessions": [session]},
        "TARGETS.md": {"version": "runtime_target_registry_v1", "targets": [target]},
        "c.yaml": contract,
    }
    return documents, {"SESSIONS.md": session, "TARGETS.md": target, "c.yaml": contract}


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_each_unknown_key_is_reported_exactly_once(write, data):
    documents, entries = build_documents()
    planted = set()
    for name, places in PLACES.items():
        for place in places:
            table, owner = KINDS[documents[name]["version"]].fields, entries[name]
            for step in place:
                table, owner = table[step], owner[step]
            for key in data.draw(st.lists(KEYS, max_size=2, unique=True)):
                if key in table or key in owner:
                    continue
                owner[key] = data.draw(st.sampled_from([1, None, "text", [1, 2], {"id": 3, "status": "pending"}]))
                planted.add((name, ".".join((*place, key))))
    paths = {name: write(document, name) for name, document in documents.items()}
    draft = draft_of(*paths.values())

    told = [each for each in draft.remarks if each.kind is RemarkKind.UNKNOWN]
    assert sorted((Path(each.address.rsplit(":", 2)[0]).name, each.field) for each in told) == sorted(planted)
    for each in told:
        path, line, column = each.address.rsplit(":", 2)
        assert Path(path).read_text(encoding="utf-8").splitlines()[int(line) - 1][int(column) - 1 :].strip()


def test_names_that_become_equal_are_told_apart(sessions):
    draft = draft_of(sessions({"session_id": "s-1"}, {"session_id": "s_1"}, {"session_id": "S 1"}, {"session_id": "1"}))
    nodes = yaml.safe_load(draft.files["goal_graphs/imported.yaml"])["sessions"]

    assert list(nodes) == ["s_1", "s_1_2", "s_1_3", "n_1"]
    renamed = [each.reason for each in draft.remarks if each.kind is RemarkKind.RENAMED]
    assert renamed == ["'s-1' is 's_1' here", "'s_1' is 's_1_2' here", "'S 1' is 's_1_3' here", "'1' is 'n_1' here"]


def test_a_cycle_is_broken_and_told(sessions):
    draft = draft_of(
        sessions(
            {"depends_on": ["s2"]},
            {"session_id": "s2", "depends_on": ["s1"]},
            {"session_id": "s3", "depends_on": ["s3"]},
        )
    )
    nodes = yaml.safe_load(draft.files["goal_graphs/imported.yaml"])["sessions"]

    assert [nodes[name].get("after") for name in ("s1", "s2", "s3")] == [["s2"], None, None]
    assert len([each for each in draft.remarks if each.field == "depends_on" and "cycle" in each.reason]) == 2


def test_older_names_of_fields_and_lists_are_read(write):
    entry = {key: value for key, value in SESSION.items() if key != "skillruntime_ref"} | {"skill_ref": "skill://vla"}
    draft = draft_of(
        write({"version": "runtime_sessions_v1", "sessions": [entry]}),
        write(
            {"version": "runtime_skill_registry_v1", "skills": [{"id": "vla", "runtime_kind": "policy"}]}, "SKILLS.md"
        ),
        write({"version": "runtime_target_registry_v1", "targets": [{"id": "arm", "type": "sim"}]}, "TARGETS.md"),
    )
    assert node_of(draft)["skill"] == "vla"
    assert "kind: policy\n" in draft.files["skills/vla/SKILL.md"]
    assert [each for each in draft.remarks if each.kind in {RemarkKind.UNKNOWN, RemarkKind.NOT_MAPPED}] == []


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(texts=st.lists(st.text(max_size=40), min_size=3, max_size=3), id=st.text(min_size=1).filter(str.strip))
def test_any_text_comes_through_and_breaks_no_draft(write, texts, id):
    entry = SESSION | {
        "session_id": id,
        "goal_id": texts[0],
        "task_description": texts[1],
        "target_ref": f"target://{id}",
        "verification": {"goal": texts[2], "success_criteria": texts},
    }
    document = yaml.safe_dump({"version": "runtime_sessions_v1", "sessions": [entry]}, allow_unicode=False)
    draft = draft_of(write(document))

    for name, text in draft.files.items():
        if name.startswith("goal_graphs/"):
            [node] = yaml.safe_load(text)["sessions"].values()
            assert node["objective"] == texts[1] or not texts[1]
        elif name.endswith(".yaml"):
            assert isinstance(yaml.safe_load(text), dict)


def test_every_draft_of_the_fixture_is_sound_yaml(old, tmp_path):
    for name, text in old.files.items():
        if name.endswith(".yaml"):
            path = tmp_path / Path(name).name
            path.write_text(text, encoding="utf-8")
            read_yaml(path)
