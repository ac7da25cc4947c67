"""What a start costs with many archived sessions: time above that of the interpreter, and memory per session."""

import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

from .sessions import LANE

_OPEN = """
import sys
from pathlib import Path
from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.lifecycle import Side
from phyagentos.store.journal import Journal
journal = Journal(Path(sys.argv[1]), side=Side.RUNTIME, by="start", clock=SystemClock(), partition=sys.argv[2])
ledger = journal.open_ledger()
"""
_TELL = """
import json
pages = int(Path("/proc/self/statm").read_text().split()[1])
print(json.dumps({"bytes": pages * __import__("os").sysconf("SC_PAGE_SIZE"), "sessions": ledger.session_count}))
"""


def measure_start(stored: Path, empty: Path, repeats: int) -> dict[str, float]:
    """Start with the journal open and the ledger complete, above an interpreter that does nothing.

    The least of several is what the start costs; the median tells how busy the machine was. Modules are loaded from
    bytecode, as an installation has it: what the first of several writes beside the store.
    """
    ours, nothing = [], []
    for _ in range(repeats):
        nothing.append(_time("pass", empty))
        ours.append(_time(_OPEN, stored))
    sessions = _ask(_OPEN + _TELL, stored)
    none = _ask(_OPEN + _TELL, empty)
    return {
        "interpreter_start_ms": 1e3 * min(nothing),
        "start_ms_above_interpreter": 1e3 * (min(ours) - min(nothing)),
        "start_ms_above_interpreter_median": 1e3 * (statistics.median(ours) - statistics.median(nothing)),
        "start_sessions": sessions["sessions"],
        "start_bytes_per_known_session": (sessions["bytes"] - none["bytes"]) / max(1, sessions["sessions"]),
    }


def _time(code: str, root: Path) -> float:
    begin_s = time.perf_counter()
    subprocess.run([sys.executable, "-c", code, str(root), LANE], check=True, env=_keep_bytecode(root))
    return time.perf_counter() - begin_s


def _ask(code: str, root: Path) -> dict[str, float]:
    order = [sys.executable, "-c", code, str(root), LANE]
    told = subprocess.run(order, check=True, stdout=subprocess.PIPE, env=_keep_bytecode(root))
    found: dict[str, float] = json.loads(told.stdout)
    return found


def _keep_bytecode(root: Path) -> dict[str, str]:
    plain = {name: text for name, text in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return plain | {"PYTHONPYCACHEPREFIX": str(root.parent / "bytecode")}
