"""A journal on a folder of its own, and contracts to put into it."""

from contextlib import ExitStack, closing

import msgspec
import pytest

from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.protocol.sessions.session import Scene, Session
from phyagentos.store.journal import Entry, Journal
from phyagentos.testing import ManualClock

from .edit_stand import EditStand
from .evidence_bundles import Store
from .readers import flatten, read_with_python


def make_session(id="tidy-7.red", **changes):
    facts = {
        "id": id,
        "goal": "tidy-7",
        "node": "red",
        "objective": "Put the red cube into the red tray",
        "skill": "pick_and_place",
        "target": "panda",
        "parameters": {"object": "red_cube", "destination": "red_tray"},
        "accept": ("inside(red_cube, red_tray)",),
        "scene": Scene(name="tabletop/cubes_and_trays", seed=7, episode="tidy-7"),
        "seed": 7,
    }
    return Session(**(facts | changes))


def make_submit(id="tidy-7.red", **changes):
    return Entry(id, "submit", msgspec.to_builtins(make_session(id, **changes)))


def make_course(id, execution, start=None):
    """The entries of the runtime from claim to finish."""
    return [
        Entry(id, "claim"),
        Entry(id, "check"),
        Entry(id, "start", start, 1),
        Entry(id, "halt"),
        Entry(id, "finish", {"execution": execution}, 1),
    ]


@pytest.fixture
def store(tmp_path):
    """A workspace in which bundles of evidence are left."""
    with closing(Store(tmp_path / "w", make_submit)) as made:
        yield made


@pytest.fixture
def contract():
    return make_session


@pytest.fixture
def submit():
    return make_submit


@pytest.fixture
def clock():
    return ManualClock(1_000_000.0)


@pytest.fixture
def open_journal(tmp_path, clock):
    with ExitStack() as opened:

        def open_one(side=Side.AGENT, by="", **options):
            facts = {"side": side, "by": by or str(side), "clock": clock, "durable": False}
            return opened.enter_context(closing(Journal(tmp_path, **(facts | options))))

        yield open_one


@pytest.fixture
def stand(tmp_path, clock, submit):
    """Two sessions that wait, in a workspace that is edited."""
    with closing(EditStand(tmp_path / "w", clock)) as stand:
        stand.commit("agent", submit("a"), submit("b"))
        stand.settle(1)
        yield stand


@pytest.fixture
def agree(tmp_path, read_with_node):
    """What both readers say about the journal below `tmp_path`, after asserting that it is the same."""

    def compare():
        expected = read_with_python(tmp_path)
        assert [flatten(each) for each in read_with_node(tmp_path)] == [expected]
        return expected

    return compare
