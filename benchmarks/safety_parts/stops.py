"""How long an emergency stop takes in real time: request to silence, request to rest.

A client swings the arm at full speed over the bare wire, without a guard that would fall silent by itself. Another
thread asks for the stop at a random moment. Each figure is counted twice, by the wall clock and by simulated time since
the state that stood at the request, and the larger of both counts: the world may be some periods ahead of the clock.

- silence: the last command that the target's receive log shows as accepted after the request; 0 where none was. By the
  wall clock its arrival (`at`), by simulated time the end of its execution.
- refused: when the first command was refused; it waits for its turn until the deceleration is over.
- rest: the last row of the eye with a joint faster than 1 % of its limit.
"""

import datetime
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.safety_parts.attacker import SHARE, Array, Attacker, Seen
from phyagentos.clock import SystemClock
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.sessions.estop import Latch, is_latched, latch, reset
from phyagentos.protocol.sessions.stop_signals import Signal, drop_signal, take_signals
from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.receive_log import Reception

SWUNG = np.array((1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0))  # joints that may swing about home and touch nothing
SWING_RAD = 0.45  # where a joint turns round; it needs some 0.15 more
DELAY_S = (0.06, 0.45)  # from the first command to the request
REST_SHARE = 0.01  # of the velocity limit
CLOCK = SystemClock()


@dataclass(frozen=True, slots=True)
class Trial:
    """One stop.

    Attributes:
        dropped: Whether it was asked for by a file in `signals/new/` instead of the latch itself.
        request_s: Wall time just before it was asked for.
        asked_s: Wall time when whoever asked had done so.
        over_s: Wall time when the session had ended.
    """

    session: str
    dropped: bool
    request_s: float
    asked_s: float
    over_s: float


def swing(attacker: Attacker, rng: np.random.Generator, signals: Path, *, dropped: bool) -> Trial | None:
    """One trial; None when the stream broke off before the request, for lack of processor time."""
    home = np.array(attacker.profile.arm.home_rad)
    q, qd = attacker.begin(), np.zeros(7)
    direction = np.where(q > home, -1.0, 1.0)
    asked: list[float] = []

    def ask_for_stop() -> None:
        CLOCK.sleep(float(rng.uniform(*DELAY_S)))
        asked.append(1e-9 * time.time_ns())
        if dropped:
            drop_signal(signals, Signal(kind="estop", by="benchmark"), CLOCK)
        else:
            latch(signals, Latch(by="benchmark", reason="a trial", at=CLOCK.wall_iso()))
        asked.append(1e-9 * time.time_ns())

    thread = threading.Thread(target=ask_for_stop)
    thread.start()
    reply: object = None
    while True:
        away = (q - home) * direction
        direction = np.where(away > SWING_RAD, -direction, direction)
        rows = attacker.ramp(q, qd, SHARE * SWUNG * attacker.velocity * direction, share=0.9)
        reply = attacker.send(*rows)
        if not isinstance(reply, wire.Step) or reply.stopped:
            break
        q, qd = rows[0][-1], rows[1][-1]
    thread.join()
    while not is_latched(signals):  # where the stream broke off first; the world looks once a period
        CLOCK.sleep(0.002)
    attacker.end()
    over_s = 1e-9 * time.time_ns()
    take_signals(signals)
    reset(signals, "the trial is over", CLOCK)
    stopped = isinstance(reply, wire.Refused) and reply.code == "ESTOPPED"
    return Trial(attacker.session, dropped, *asked, over_s) if stopped else None


def read_log(path: Path) -> dict[str, list[Reception]]:
    """Commands of every session, in order."""
    sessions: dict[str, list[Reception]] = {}
    for line in path.read_bytes().splitlines():
        reception = msgspec.json.decode(line, type=Reception)
        if reception.kind == "Command":
            sessions.setdefault(reception.session, []).append(reception)
    return sessions


def _parse_s(at: str) -> float:
    return datetime.datetime.fromisoformat(at).timestamp()


def measure_trial(trial: Trial, commands: Sequence[Reception], seen: Seen, velocity: Array) -> dict[str, float]:
    """Figures of one trial [s], and `speed`, the share of its limit at which the fastest joint moved at the request."""
    request = max(int(np.searchsorted(seen.wall_s, trial.request_s, side="right")) - 1, 0)
    over = int(np.searchsorted(seen.wall_s, trial.over_s, side="right"))
    shares = (np.abs(seen.qd[request:over]) / velocity).max(axis=1)
    moving = np.flatnonzero(shares >= REST_SHARE)
    rest = request + (int(moving[-1]) + 1 if len(moving) else 0)
    rest = min(rest, over - 1)
    since_s = float(seen.time_s[request])
    late = [each for each in commands if each.accepted and _parse_s(each.at) > trial.request_s]
    refused = next(each for each in commands if each.code == "ESTOPPED")
    return {
        "silence_wall": _parse_s(late[-1].at) - trial.request_s if late else 0.0,
        "silence_simulated": max(late[-1].time_s - since_s, 0.0) if late else 0.0,
        "refused": _parse_s(refused.at) - trial.request_s,
        "rest_wall": max(float(seen.wall_s[rest]) - trial.request_s, 0.0),
        "rest_simulated": float(seen.time_s[rest]) - since_s,
        "after_request": float(len(late)),
        "after_asked": float(sum(_parse_s(each.at) > trial.asked_s for each in late)),
        "speed": float(shares[0]),
        "still_moving": float(shares[-1] >= REST_SHARE),
    }


def measure_stops(folder: Path, profile: TargetProfile, count: int, seed: int = 3) -> dict[str, float]:
    """Stops at random phases of a motion, every other one asked for by a dropped file.

    Args:
        folder: Scratch.
        profile: The robot.
        count: Trials that are wanted; those whose stream broke off are made again.
        seed: Of the moments.

    Returns:
        Figures; among them commands that were accepted after the request, and after the asking was done.
    """
    signals, log = folder / "signals", folder / "receive.jsonl"
    attacker = Attacker(folder, profile, ("--realtime", "--signals", str(signals), "--log", str(log)))
    rng, trials, repeated = np.random.default_rng(seed), list[Trial](), 0
    try:
        while len(trials) < count and repeated <= count:
            trial = swing(attacker, rng, signals, dropped=len(trials) % 2 == 1)
            repeated += trial is None
            if trial is not None:
                trials.append(trial)
        seen = attacker.finish()
    finally:
        attacker.kill()
    sessions = read_log(log)
    found = [measure_trial(trial, sessions[trial.session], seen, attacker.velocity) for trial in trials]
    columns = {name: np.array([each[name] for each in found]) for name in found[0]}
    period_s = profile.control_period_s
    figures = {"stops": float(len(trials)), "stops_repeated": float(repeated)}
    spans = {
        "silence": np.maximum(columns["silence_wall"], columns["silence_simulated"]),
        "refused": columns["refused"],
        "rest": np.maximum(columns["rest_wall"], columns["rest_simulated"]),
    }
    dropped = np.array([trial.dropped for trial in trials])
    spans["silence_latch"], spans["silence_file"] = spans["silence"][~dropped], spans["silence"][dropped]
    for name, spent_s in spans.items():
        for label, value_s in summarise(spent_s).items():
            figures[f"{name}_{label}_ms"] = 1e3 * value_s
            figures[f"{name}_{label}_periods"] = value_s / period_s
    figures["commands_after_request_max"] = float(columns["after_request"].max())
    figures["commands_after_asked"] = float(columns["after_asked"].sum())
    figures["asking_p99_ms"] = 1e3 * float(np.quantile([each.asked_s - each.request_s for each in trials], 0.99))
    figures["stops_still_moving"] = float(columns["still_moving"].sum())
    figures["speed_at_request_median"] = float(np.median(columns["speed"]))
    return figures


def summarise(spent_s: Array) -> dict[str, float]:
    """p50, p99 and max [s]; NaN without values."""
    if not len(spent_s):
        return dict.fromkeys(("p50", "p99", "max"), float("nan"))
    return {
        "p50": float(np.quantile(spent_s, 0.5)),
        "p99": float(np.quantile(spent_s, 0.99)),
        "max": float(spent_s.max()),
    }
