"""A policy of the operator permits skills, targets, scenes, times and costs, and nothing besides."""

import pytest
import yaml

from phyagentos.agent.goals.graph import read_goal_graph
from phyagentos.agent.tools.proposals import ApprovalPolicy, iter_objections, restrict
from phyagentos.errors import DefinitionError
from phyagentos.protocol.documents.schema import read_yaml, validate

POLICY = {
    "skills": ["pick_and_place"],
    "targets": ["panda"],
    "from_utc": "08:00",
    "until_utc": "18:00",
    "budget": {"goals_a_day": 2, "sessions": 6, "sim_time_s": 120},
}
GRAPH = """
goal: tidy
objective: Tidy up.
scene: table
budget: {sessions: 4, sim_time_s: 60}
sessions:
  red: {skill: pick_and_place, target: panda, with: {object: red_cube, destination: red_tray}}
accept: ["inside(red_cube, red_tray)"]
"""
NOON, NIGHT = "2026-11-26T12:00:00.000000Z", "2026-11-26T23:30:00.000000Z"


def read_policy(path):
    return validate(ApprovalPolicy, read_yaml(path))


@pytest.fixture
def judge(tmp_path, write_graph, catalogue):
    def judge(graph=GRAPH, at=NOON, approved=0, **policy):
        (tmp_path / "policy.yaml").write_text(yaml.safe_dump(POLICY | policy))
        read = read_goal_graph(write_graph(graph), catalogue)
        found = list(iter_objections(read_policy(tmp_path / "policy.yaml"), read, at=at, approved=approved))
        assert {each.code for each in found} <= {"NOT_PERMITTED"}
        return [each.address.removeprefix("tidy: ") for each in found]

    return judge


def test_what_is_within_every_bound_is_permitted(judge):
    assert judge() == []


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"skills": ["pick"]}, "red.skill"),
        ({"targets": ["ur5e"]}, "red.target"),
        ({"scenes": ["kitchen"]}, "scene"),
        ({"at": NIGHT}, "time"),
        ({"approved": 2}, "goals"),
        ({"graph": GRAPH.replace("sessions: 4", "sessions: 7")}, "budget.sessions"),
        ({"graph": GRAPH.replace(", sim_time_s: 60", "")}, "budget.sim_time_s"),
    ],
)
def test_each_bound_is_held(judge, change, where):
    assert judge(**change) == [where]


def test_a_span_may_cross_midnight(judge):
    assert judge(at=NIGHT, from_utc="22:00", until_utc="06:00") == []
    assert judge(at=NOON, from_utc="22:00", until_utc="06:00") == ["time"]


def test_every_objection_is_named(judge):
    assert judge(skills=["x"], targets=["y"], at=NIGHT, approved=9) == ["time", "goals", "red.skill", "red.target"]


@pytest.mark.parametrize("wrong", [{"skills": []}, {"budget": {}}, {"from_utc": "25:00"}, {"anything": 1}])
def test_a_policy_that_says_too_little_or_too_much_is_refused(tmp_path, wrong):
    (tmp_path / "policy.yaml").write_text(yaml.safe_dump(POLICY | wrong))
    with pytest.raises(DefinitionError):
        read_policy(tmp_path / "policy.yaml")


def test_a_goal_and_its_repairs_choose_among_what_is_permitted_alone(tmp_path, catalogue):
    (tmp_path / "policy.yaml").write_text(yaml.safe_dump(POLICY))
    restricted = restrict(read_policy(tmp_path / "policy.yaml"), catalogue)
    assert set(restricted.skills) == {"pick_and_place"} < set(catalogue.skills)
    assert set(restricted.targets) == {"panda"}
