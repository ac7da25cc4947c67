"""Writes a project: a scene and a goal graph for each task of a table, and the suite that runs them all.

    python examples/projects/08_meta_world/generate.py build/meta_world [--table tasks.yaml]

Robot, limits and skills are copied; the table says what must be observed in the end.
"""

import argparse
import shutil
from pathlib import Path
from typing import Any

import yaml

HERE = Path(__file__).resolve().parent
COPIED = ("robots", "protocol", "skills")
SOLID = {"kind": "box", "size_m": [0.02, 0.02, 0.02]}
NOWHERE = {"center_m": [0.0, 0.0, 0.0], "half_m": [9.0, 9.0, 9.0]}  # where it is, the environment says


def write_project(folder: Path, table: dict[str, Any]) -> Path:
    """The project; its suite."""
    for name in COPIED:
        shutil.copytree(HERE / name, folder / name, dirs_exist_ok=True)
    robot = yaml.safe_load((HERE / "robots" / "sawyer" / "gymnasium.yaml").read_text())
    bodies = {name: {"kind": each["kind"], "shapes": [SOLID]} for name, each in robot["entities"].items()}
    regions = dict.fromkeys(robot["regions"], NOWHERE)
    for task, accept in table["accept"].items():
        scene = {"scene": task, "bodies": bodies, "regions": regions, "cameras": {}, "settle_s": 0.0}
        dump(folder / "scenes" / f"{task}.yaml", scene)
        dump(folder / "goal_graphs" / f"{name_of(task)}.yaml", make_graph(task, accept))
    names, experts = map(name_of, table["accept"]), str(HERE / "experts.py")
    suite = table["template"]
    for policy in suite["policies"].values():
        policy["serve"] = [experts if word == "EXPERTS" else word for word in policy["serve"]]
    tasks = {name: {"graph": f"goal_graphs/{name}.yaml", "score": {"act": "success"}} for name in names}
    dump(folder / "suite.yaml", suite | {"tasks": tasks})
    return folder / "suite.yaml"


def make_graph(task: str, accept: list[str]) -> dict[str, Any]:
    """One node of the expert, and what must be true at its end."""
    words = task.removesuffix("-v3").replace("-", " ")
    act = {"objective": words, "skill": "expert", "target": "hand", "accept": accept}
    return {
        "goal": name_of(task), "objective": words, "scene": task, "targets": {"hand": "sawyer"},
        "defaults": {"timeout_s": 7.0, "max_replans": 2}, "sessions": {"act": act},
    }  # fmt: skip


def name_of(task: str) -> str:
    """As goals are named: `drawer_close`."""
    return task.removesuffix("-v3").replace("-", "_")


def dump(path: Path, data: dict[str, Any]) -> None:
    """Write plain data; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(data, sort_keys=False, width=120))


def main() -> None:
    """Write what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--table", type=Path, default=HERE / "tasks.yaml")
    given = parser.parse_args()
    print(write_project(given.folder, yaml.safe_load(given.table.read_text())))


if __name__ == "__main__":
    main()
