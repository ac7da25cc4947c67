"""Episodes as a verifier would leave them, and a memory that keeps them."""

from itertools import count

import msgspec
import pytest

from phyagentos.agent.memory.episodes import Episode, Features
from phyagentos.agent.memory.memory import Memory
from phyagentos.agent.memory.scopes import compute_scope
from phyagentos.protocol.sessions.memory_entries import Embodiment
from phyagentos.protocol.sessions.strategy import DEFAULT_STRATEGY, Strategy
from phyagentos.protocol.sessions.verdicts import Verdict
from phyagentos.testing import ManualClock

PANDA = Embodiment(kind="arm", grip_width_m=0.08, grip_force_n=40.0, control_period_s=0.02)
SLOW = Strategy(speed=0.5)
_numbers = count()


def make_episode(*, ok=True, parent=None, item="soap", place="tray", strategy=None, cause="GRASP_LOST", **more):
    """One judged session; a child continues the goal and node of its parent."""
    number = next(_numbers)
    facts = {
        "session": f"g{number}.n",
        "goal": f"g{number}",
        "node": "n",
        "seed": number,
        "scene": "bench",
        "objective": f"Put the {item} into the {place}.",
        "skill": "pick_and_place",
        "target": "panda",
        "body": PANDA,
        "features": Features(object=f"{item}_1", object_kind=item, destination=f"{place}_1", destination_kind=place),
        "verdict": Verdict.SUCCESS if ok else Verdict.REPLAN,
        "cause": "" if ok else cause,
        "strategy": strategy or DEFAULT_STRATEGY,
        "evidence": f"evidence/g{number}.n",
    }
    if parent is not None:
        facts |= {"goal": parent.goal, "node": parent.node, "seed": parent.seed, "parent": parent.session}
        facts |= {"scene": parent.scene, "features": parent.features, "target": parent.target, "body": parent.body}
    return Episode(**(facts | more))


def make_correction(*, ok=True, strategy=None, **more):
    """A failure, and the child that tried something else."""
    failed = make_episode(ok=False, **more)
    return [failed, make_episode(ok=ok, parent=failed, strategy=SLOW if strategy is None else strategy)]


def teach(memory, **facts):
    """Record a correction; the failure that it corrects."""
    pair = make_correction(**facts)
    memory.record(pair)
    return pair[0]


def ask(episode, **changes):
    """The scope of an episode."""
    return msgspec.structs.replace(compute_scope(episode), **changes)


@pytest.fixture
def open_memory(tmp_path):
    """Opens the memory of a test; every call begins anew from the disk."""
    return lambda name="memory", by="test": Memory(tmp_path / name, clock=ManualClock(), by=by, durable=False)


@pytest.fixture
def memory(open_memory):
    return open_memory()
