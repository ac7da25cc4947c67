"""Random histories: goals and sessions that begin, go on and end in every order that the journal admits."""

from hypothesis import strategies as st

from phyagentos.protocol.sessions.lifecycle import SESSION_TRANSITIONS, IllegalTransition, Side
from phyagentos.store.journal import Entry, Fenced, IllegalEvent, Journal
from phyagentos.store.ledger import Ledger
from phyagentos.testing import ManualClock

EXECUTION = {"ended": "completed", "evidence": "evidence/s", "outputs": {"place_site": [0.1, float("inf"), None]}}
ATTEMPT = {
    "verdict": "success",
    "criteria": [{"text": "a", "kind": "accept", "truth": "true", "measured": {"d_m": 0.1}}],
}
BODIES = {
    "finish": {"execution": EXECUTION},
    "accept": {"attempt": ATTEMPT},
    "review": {"attempt": ATTEMPT | {"verdict": "failure", "is_review": True}},
    "cancel": {"reason": "enough"},
}
LIFE = ("claim", "check", "start", "halt", "finish", "verify", "accept")
SIDES = {row.trigger: row.by[0] for row in SESSION_TRANSITIONS}

_NUMBERS = st.integers(0, 4)
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("goal"), _NUMBERS),
        st.tuples(st.sampled_from(["verdict", "stop", "node"]), _NUMBERS),
        st.tuples(st.just("session"), st.sampled_from(["", "g0", "g1", "g2", "g3", "g4"])),
        st.tuples(st.just("live"), st.integers(0, 60)),
        st.tuples(st.sampled_from(sorted(SIDES)), st.integers(0, 60)),
    ),
    max_size=60,
)


class Story:
    """Three writers in one lane, and the step that was asked for last."""

    def __init__(self, root, submit, **options):
        settings = {
            "clock": ManualClock(1_000_000.0),
            "durable": False,
            "segment_bytes": 4000,
            "partition": "here",
        } | options
        self.pens = {side: Journal(root, side=side, by=side.value, **settings) for side in Side}
        self.folder = root / "sessions" / "here"
        self._submit = submit
        self.sessions = []

    def tell(self, steps):
        for step in steps:
            self.take(*step)

    def take(self, kind, which):
        goal = f"goal:g{which}"
        match kind:
            case "goal":
                nodes = {"nodes": {"red": {"skill": "pick"}, "blue": {"after": ["red"]}}}
                self.record(Side.AGENT, Entry(goal, "goal_submitted", {"seed": 7}), Entry(goal, "goal_compiled", nodes))
            case "verdict":
                self.record(Side.AGENT, Entry(goal, "goal_verdict", {"verdict": "success"}))
            case "stop":
                self.record(Side.OPERATOR, Entry(goal, "goal_cancelled", {"reason": "supper"}))
            case "node":
                self.record(Side.AGENT, Entry(f"node:g{which}/blue", "node_blocked", {"reason": "gone"}))
            case "session":
                id = f"s{len(self.sessions)}"
                if self.record(Side.AGENT, self._submit(id, goal=which, priority=len(self.sessions) % 3)):
                    self.sessions.append(id)
            case "live":
                for trigger in LIFE:
                    self._fire(trigger, which)
            case trigger:
                self._fire(trigger, which)

    def _fire(self, trigger, which):
        if self.sessions:
            id = self.sessions[which % len(self.sessions)]
            self.record(SIDES[trigger], Entry(id, trigger, BODIES.get(trigger)))

    def record(self, side, *entries):
        try:
            return self.pens[side].commit(entries)
        except (IllegalTransition, IllegalEvent, Fenced):
            return None

    def close(self):
        for pen in self.pens.values():
            pen.close()


def fold(records, ledger=None, **options):
    ledger = ledger or Ledger(**options)
    ledger.extend(records)
    return ledger
