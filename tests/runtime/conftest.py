"""Fixtures for the worker's side of a session, on the public doubles."""

import pytest

from phyagentos import testing
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.sessions.session import GoalId, Limits, Scene, Session, SessionId
from phyagentos.runtime.execution.leaf_registry import LeafRegistry, build_registry
from phyagentos.testing import PerfectTarget, SkillStand, make_cube, read_robot


@pytest.fixture
def doubles():
    """The doubles, for tests that vary them."""
    return testing


@pytest.fixture(scope="session")
def profile():
    return read_robot()[0]


@pytest.fixture(scope="session")
def limits():
    return read_robot()[1]


@pytest.fixture(scope="session")
def library():
    return Library.open()


@pytest.fixture
def registry(library) -> LeafRegistry:
    return build_registry(library)


@pytest.fixture
def build_session():
    def build(**changes):
        values = {
            "id": SessionId("tidy-1.red"),
            "goal": GoalId("tidy-1"),
            "node": "red",
            "objective": "Put the red cube into the red tray.",
            "skill": "pick_and_place",
            "target": "panda",
            "parameters": {"object": "red_cube", "destination": "red_tray"},
            "accept": (),
            "scene": Scene(name="tabletop/cubes_and_trays", seed=1, episode="tidy-1"),
            "seed": 7,
            "limits": Limits(),
        }
        return Session(**{**values, **changes})

    return build


@pytest.fixture
def build_bench(tmp_path, library, registry, profile, limits):
    def build(target=None, planner=None, library=library, registry=registry, workspace=tmp_path, **others):
        target = target or PerfectTarget(profile, [make_cube(), make_cube("red_tray", (0.5, 0.3, 0.0))])
        known = {"library": library, "registry": registry, "robot": (profile, limits)}
        return SkillStand(workspace, target=target, planner=planner, **known, **others)

    return build


@pytest.fixture
def gripping(profile):
    """A perfect target whose fingers close on the red cube."""
    return PerfectTarget(profile, [make_cube(), make_cube("red_tray", (0.5, 0.3, 0.0))], graspable="red_cube")


@pytest.fixture
def plant(tmp_path):
    """A library with one more tree."""

    def plant(children, header=""):
        (tmp_path / "trees").mkdir(exist_ok=True)
        listed = "".join(f"      - {child}\n" for child in children)
        text = f"tree: planted\ndescription: A tree.\n{header}root:\n  sequence:\n    children:\n{listed}"
        (tmp_path / "trees" / "planted.yaml").write_text(text)
        return Library((tmp_path, find_shipped_root()))

    return plant


@pytest.fixture
def session(build_session):
    return build_session(skill="planted", parameters={})
