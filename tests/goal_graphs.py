"""The agent's graph of a goal beside the one that its records draw."""

from phyagentos.agent.goals.dag import GoalDag
from phyagentos.protocol.sessions.tasks import GoalStatus, NodeState, iter_edges, iter_steps


def assert_same_graph(dag: GoalDag, goal: GoalStatus) -> None:
    """Vertices with their states, edges with their relations, and what is ready are the same."""
    steps = {step.name: step for step in iter_steps(goal)}
    edges = {(edge.before, edge.step): edge.relation for edge in iter_edges(goal)}
    assert {name: (facts["node"], facts["state"]) for name, facts in dag.steps.nodes.items()} == {
        name: (step.node, step.state) for name, step in steps.items()
    }
    assert {(before, step): facts["relation"] for before, step, facts in dag.steps.edges(data=True)} == edges
    closed = {name for name, step in steps.items() if step.state in {NodeState.DONE, "past"}}
    for name, facts in dag.steps.nodes.items():
        assert facts["waits"] == sum(step == name and before not in closed for before, step in edges), name
