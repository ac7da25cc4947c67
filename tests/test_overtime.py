"""A person's code that never ends is interrupted where it stands, and its error has that line."""

import signal
import threading
from contextlib import suppress

import pytest

from phyagentos.clock import SystemClock
from phyagentos.errors import DefinitionError, blaming
from phyagentos.overtime import Overtime, limit_time, renew_limit
from phyagentos.protocol.predicates import evaluation
from phyagentos.protocol.predicates.library import PredicateDefinition, get_predicate_library
from phyagentos.protocol.predicates.predicate import View, parse_predicate
from phyagentos.protocol.world.truth import Truth
from phyagentos.runtime.execution import leaf
from phyagentos.runtime.execution.leaf import LeafError
from phyagentos.testing import make_world

SHORT_S = 0.05


def rest(seconds):
    threading.Event().wait(seconds)


def spin():
    while True:
        with suppress(Exception):  # as a person writes it
            rest(0.001)


@pytest.mark.parametrize("wait", [spin, threading.Event().wait, lambda: [None for _ in iter(int, 1)]])
def test_what_never_ends_is_interrupted(wait):
    began_s, handler = SystemClock().now_s(), signal.getsignal(signal.SIGALRM)
    with pytest.raises(Overtime, match=r"it has run for 0\.05 s"), limit_time(SHORT_S):
        wait()
    assert SystemClock().now_s() - began_s < 5.0
    assert signal.getsignal(signal.SIGALRM) is handler


def test_what_ends_in_time_is_left_alone_and_limits_within_limits_hold():
    with limit_time(10.0):
        with limit_time(0.02):
            pass
        rest(0.05)
        with pytest.raises(Overtime), limit_time(SHORT_S):
            spin()
        assert 5.0 < signal.getitimer(signal.ITIMER_REAL)[0] < 10.0
    with pytest.raises(Overtime, match=r"0\.05 s"), limit_time(SHORT_S), limit_time(10.0):
        spin()


def test_signs_of_life_renew_a_limit():
    with limit_time(0.2):
        for _ in range(5):
            rest(0.06)
            renew_limit()


def test_another_thread_has_no_limit():
    ended = threading.Event()

    def run():
        with limit_time(SHORT_S):
            rest(0.15)
        ended.set()

    threading.Thread(target=run).start()
    assert ended.wait(5.0)


def test_a_leaf_that_never_ends_is_an_error_at_its_line(monkeypatch):
    class Endless(leaf.Leaf):
        def on_start(self):
            spin()

    monkeypatch.setattr(leaf, "TICK_S", SHORT_S)
    with pytest.raises(
        LeafError, match=r"leaf root/endless: Overtime: it has run for 0\.05 s.*test_overtime\.py:\d+\)"
    ):
        Endless("endless", None, "root/endless").tick_once()


def test_a_predicate_that_never_ends_is_a_defect_at_its_line(monkeypatch):
    monkeypatch.setattr(evaluation, "MEASURE_S", SHORT_S)
    gap = PredicateDefinition(name="gap", arguments=(), measure=lambda view: spin())
    monkeypatch.setitem(get_predicate_library()._definitions, "gap", gap)
    found = parse_predicate("gap()").evaluate(View(now=make_world()))
    assert (found.truth, found.defect.rpartition(":")[0]) == (Truth.UNKNOWN, __file__)


def load_endlessly():
    with blaming("loading", spin, limit_s=SHORT_S):
        spin()


def test_code_that_never_loads_is_refused_with_its_line():
    with pytest.raises(DefinitionError, match=r"test_overtime\.py:\d+: BROKEN_PYTHON: found loading raised Overtime"):
        load_endlessly()
