"""Tasks of trained policies of different strength: each by a skill of its own, whose server listens at its own port."""

import shutil
from functools import partial
from pathlib import Path

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "projects" / "10_train_policy"
PORTS = {
    "pick_by_state": 5558,
    "state_15": 5561,
    "state_20": 5562,
    "state_300": 5563,
}  # of weights: of so many episodes, of so many steps; and of the example


def draw(task: str, _seed: int, folder: Path) -> Path:
    """Write the project of a task; its goal graph."""
    shutil.copytree(EXAMPLE / "scenes", folder / "scenes")
    text = (EXAMPLE / "skills" / "pick_by_state" / "SKILL.md").read_text(encoding="utf-8")
    for name, port in PORTS.items():
        path = folder / "skills" / name / "SKILL.md"
        path.parent.mkdir(parents=True)
        path.write_text(text.replace("skill: pick_by_state", f"skill: {name}").replace(":5558", f":{port}"))
    (folder / "goal_graphs").mkdir()
    return Path(shutil.copy(EXAMPLE / "goal_graphs" / f"{task}.yaml", folder / "goal_graphs"))


draw_cube, draw_crowd, draw_block = (partial(draw, task) for task in ("cube", "crowd", "block"))
