"""Green paint in ScienceWorld, as a project whose seed is a variation of one of the environment's tasks.

The paint is asked of the skill that carries what there is: that it has to be mixed first is found by repair.
"""

from pathlib import Path

from benchmarks.scienceworld import write_project

TASK = "chemistry-mix-paint-secondary-color"  # of whose variations those before the twelfth ask for green
GOAL = f"""\
goal: green_paint
objective: Create green paint, and focus on it.
scene: {TASK}
targets: {{agent: scientist}}
defaults: {{timeout_s: 250, wall_timeout_s: 600, max_replans: 6}}
sessions:
  paint: {{skill: hold, target: agent, with: {{what: green_paint}}}}
  attend: {{after: [paint], skill: attend, target: agent, with: {{what: green_paint}}}}
accept: ["vital(attended) >= 1"]
"""


def draw(seed: int, folder: Path) -> Path:
    """The goal graph in a project of its own; the seed acts by the world alone."""
    graph = write_project(folder, [{"task": TASK}]) / "goal_graphs" / "green_paint.yaml"
    graph.write_text(GOAL, encoding="utf-8")
    return graph
