"""A workspace that an earlier version recorded, with a small scene model for the session that lost its cube."""

import threading
from pathlib import Path
from types import SimpleNamespace

import mujoco
import pytest
from PIL import Image

from phyagentos.bench import many
from phyagentos.bench.engines import Engine
from phyagentos.bench.records import EpisodeRecord, SessionRecord
from phyagentos.operations import run
from phyagentos.operations.progress import RunFold
from phyagentos.operations.workspaces import read_ledger
from phyagentos.protocol.capabilities.registries import get_registered_target
from phyagentos.protocol.sessions.evidence import (
    INITIAL,
    PICTURE_AFTER,
    PICTURE_BEFORE,
    SCENE_MODEL,
    TERMINAL,
    TRAJECTORY,
)
from phyagentos.protocol.sessions.session import GoalId
from phyagentos.protocol.workspace.array_files import decode_arrays, encode_arrays
from phyagentos.protocol.workspace.workspace import Workspace
from tests.stored_workspace import unpack_stored

GOAL = "tidy_table-7"


@pytest.fixture(scope="session")
def stored(tmp_path_factory):
    """`workspaces/demo` in a folder of its own."""
    folder = tmp_path_factory.mktemp("api") / "workspaces"
    root = unpack_stored(folder).rename(folder / "demo")
    add_scene(Workspace.open(root), root / "evidence" / f"{GOAL}.red")
    return root


def add_scene(workspace, bundle):
    """What was not stored for its size: here a chain of the arm's joints, with its tool at the end."""
    profile = get_registered_target(workspace.target_registry, "panda")
    begin = "".join(
        f'<body pos="0 0 0.2"><joint name="{name}" axis="0 1 0"/><geom size="0.05"/>' for name in profile.arm.joints
    )
    end = f'<site name="{profile.tcp}"/>' + "</body>" * len(profile.arm.joints)
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{begin}{end}</worldbody></mujoco>")
    mujoco.mj_saveModel(model, str(bundle / SCENE_MODEL))
    measured = decode_arrays((bundle / TRAJECTORY).read_bytes())["q_measured"]
    for name, row in ((INITIAL, 0), (TERMINAL, -1)):
        arrays = decode_arrays((bundle / name).read_bytes()) | {"qpos": measured[row]}
        (bundle / name).write_bytes(encode_arrays(arrays))


@pytest.fixture
def asked(monkeypatch, stored):
    """Orders of runs that are checked like any other and then end with the stored workspace."""
    orders, workspace = [], run.Workspace.open(stored)

    def run_goal(order, interrupts, clock):
        graph = run.get_file(order.graph, "goal_graphs")
        faults = run.get_file(order.faults, "faults") if order.faults is not None else None
        run.check_request(graph, faults, run.parse_overrides(order.overrides))
        orders.append(order)
        fold = RunFold(workspace, GoalId(GOAL), read_ledger(stored))
        return run.build_report(fold, 1.0)

    monkeypatch.setattr(run, "run_goal", run_goal)
    return orders


@pytest.fixture
def carried(monkeypatch, tmp_path):
    """Episodes that end at once: seed 2 fails, and says so in markup; notes their jobs.

    The seed `interrupted_by` raises an interrupt, `endless` goes on until it is ended.
    """
    noted = SimpleNamespace(jobs=[], interrupted_by=None, endless=None, waits=threading.Event())

    def carry(job, is_ended):
        noted.jobs.append(job)
        order, name = job.order, job.order.id
        if order.seed == noted.interrupted_by:
            raise KeyboardInterrupt
        if order.seed == noted.endless:
            noted.waits.set()
            while not is_ended():
                threading.Event().wait(0.01)
            return None
        is_met = order.seed != 2
        bundle = f"episodes/{name}/workspace/evidence/red"
        (Path(job.run) / bundle).mkdir(parents=True)
        for picture in (PICTURE_BEFORE, PICTURE_AFTER):
            Image.new("RGB", (640, 480), "red").save(Path(job.run) / bundle / picture)
        facts = {"attempt": 0, "skill": "pick", "target": "arm", "objective": "", "state": ""}
        session = SessionRecord(id="red", node="red", bundle=bundle, taxon="" if is_met else "execution", **facts)
        axes = {"id": name, "task": order.task, "seed": order.seed, "verification": order.verification}
        verdict, reason = ("success", "") if is_met else ("failure", '<script>alert("x")</script>')
        ended = {"verdict": verdict, "reason": reason, "is_met": is_met, "sessions": (session,)}
        return EpisodeRecord(at="", folder=f"episodes/{name}", **axes, **ended)

    monkeypatch.setattr(many, "open_engine", lambda _, jobs, ends: Engine(jobs, carry, ends=ends))
    monkeypatch.chdir(tmp_path)
    return noted
