"""The agent's graph of a goal beside the one that its records draw."""

from functools import cache
from pathlib import Path

from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import read_goal_graph
from phyagentos.agent.mission.worklist import GoalDag, Worklist
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.sessions.tasks import GoalStatus, NodeState, Relation, iter_edges, iter_steps
from phyagentos.protocol.workspace.workspace import Workspace


def assert_same_graph(dag: GoalDag, goal: GoalStatus) -> None:
    """Vertices with their states, edges with their relations, and what is ready are the same."""
    steps = {step.name: step for step in iter_steps(goal)}
    edges = {(edge.before, edge.step): edge.relation for edge in iter_edges(goal)}
    assert {name: (facts["node"], facts["state"]) for name, facts in dag.steps.nodes.items()} == {
        name: (step.node, step.state) for name, step in steps.items()
    }
    assert {(before, step): facts["relation"] for before, step, facts in dag.steps.edges(data=True)} == edges
    over = {NodeState.DONE, NodeState.RESCUED, NodeState.SKIPPED, "past"}
    closed = {name for name, step in steps.items() if step.state in over}
    waited_for = [edge for edge, relation in edges.items() if relation is not Relation.ON_FAILURE]
    for name, facts in dag.steps.nodes.items():
        assert facts["waits"] == sum(step == name and before not in closed for before, step in waited_for), name


def check_recorded_graphs(base: Path) -> None:
    """Every goal of every workspace below a folder: the graph of an agent that starts anew is what its records draw."""
    read = cache(read_ledger)
    for place in ("goals", "*/goals", "*/*/goals", "*/*/*/goals"):
        for file in {path.resolve() for path in base.glob(f"{place}/*.yaml")}:
            workspace = Workspace.open(file.parents[1])
            ledger = read(workspace.root)
            if (goal := ledger.goals.get(GoalId(file.stem))) is None:
                continue  # the agent was killed before the first record, or it is the graph of an amendment
            if goal.file:
                file = file.with_name(goal.file)
            graph = read_goal_graph(file, Catalogue.of_workspace(workspace))
            assert_same_graph(Worklist(graph, goal.id, ledger).dag, goal)
