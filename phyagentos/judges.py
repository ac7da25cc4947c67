"""What a judge of sessions is written with; `phyagentos.judges` is its entry point group.

from phyagentos.judges import Bundle, Criterion, JudgeDefinition, Truth

class Haste:
# Whether a session took at most so many control periods.

name = "haste/1"

def judge(self, bundle: Bundle) -> list[Criterion]:
truth = Truth.TRUE if bundle.execution.ticks <= 500 else Truth.FALSE
return [Criterion(text="in time", kind="haste", truth=truth, evidence="execution.json", because="...")]

HASTE = JudgeDefinition(name="haste", open=lambda settings: Haste(), description="Whether in time.")
"""

from phyagentos.agent.judging.judges.judge_registry import Judge, JudgeDefinition, JudgeSettings, make_unknown
from phyagentos.protocol.sessions.evidence import Bundle
from phyagentos.protocol.sessions.session import Ended, Execution, Session
from phyagentos.protocol.sessions.trace import Role, TraceEvent
from phyagentos.protocol.sessions.verdicts import Criterion, Verdict
from phyagentos.protocol.world.truth import Truth

__all__ = [
    "Bundle",
    "Criterion",
    "Ended",
    "Execution",
    "Judge",
    "JudgeDefinition",
    "JudgeSettings",
    "Role",
    "Session",
    "TraceEvent",
    "Truth",
    "Verdict",
    "make_unknown",
]
