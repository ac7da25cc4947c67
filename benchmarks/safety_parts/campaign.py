"""The attack: recorded sessions are run again in an observed world, and between any two commands come hostile ones.

Three ways in: through the handle with its guard; straight over the wire within the same session; and, with nobody in
between, the hardest motion that the target accepts. The legitimate commands must all pass, in the midst of it.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.recorded import CUBES, Recording, Robot
from benchmarks.safety_parts.attacker import SCENE, Attacker, Seen, choose, drive_hard
from benchmarks.safety_parts.hostile import spoil_bytes, spoil_envelope, spoil_points
from phyagentos.protocol.sessions.session import Scene
from phyagentos.runtime.actions.handle import EXPIRY_PERIODS, CommandRefused, TargetSessionHandle
from phyagentos.runtime.actions.set_points import SetPoints
from phyagentos.runtime.targets import wire
from phyagentos.runtime.worker.runner import SETTLE_S

KINDS = ("noise", "bang", "oscillation", "drift", "slow drift", "full speed", "abandoned")
DRIVEN_SHARE, GUARDED_SHARE = 0.12, 0.04  # of all hostile commands: motion at the limit, without and with a guard


@dataclass
class Tally:
    """What became of everything that was sent.

    Attributes:
        sent: Hostile commands by way in.
        kinds: Hostile commands that must be refused, by kind.
        codes: Refusals by who and code.
        passed: Those of `kinds` that were carried out.
        accepted: Motion at the limit that the target, or guard and target, let through.
        legitimate: Recorded commands sent.
        legitimate_refused: And how many did not pass.
    """

    sent: Counter[str] = field(default_factory=Counter)
    kinds: Counter[str] = field(default_factory=Counter)
    codes: Counter[str] = field(default_factory=Counter)
    passed: Counter[str] = field(default_factory=Counter)
    accepted: Counter[str] = field(default_factory=Counter)
    legitimate: int = 0
    legitimate_refused: int = 0


class Intruder:
    """Somebody who holds a session's handle and its wire.

    Args:
        attacker: The world.
        robot: Its limits.
        rng: Chooses.
    """

    def __init__(self, attacker: Attacker, robot: Robot, rng: np.random.Generator) -> None:
        self.attacker, self.rng, self.tally = attacker, rng, Tally()
        self.handle = TargetSessionHandle(attacker.link, robot.limits)

    def attack_handle(self, points: SetPoints) -> None:
        """One hostile command through handle and guard."""
        kind, spoilt = spoil_points(points, self.rng, typed=True)
        self.tally.sent["handle"] += 1
        self.tally.kinds[kind] += 1
        try:
            self.handle.apply(spoilt)
        except CommandRefused as refused:
            self.tally.codes[f"{refused.by} {refused.code}"] += 1
            if refused.by == "target":  # it did not count there
                self.handle._sequence -= 1
        else:
            self.tally.passed[f"handle: {kind}"] += 1

    def attack_wire(self, points: SetPoints) -> None:
        """One hostile command of the same session past the guard."""
        handle, rng = self.handle, self.rng
        time_s = handle.step.time_s
        command = wire.Command(
            session=handle._session,
            epoch=handle._epoch,
            sequence=handle._sequence + 1,
            expires_at_s=time_s + EXPIRY_PERIODS * 0.02,
            q_rad=points.q_rad,
            qd_rad_s=points.qd_rad_s,
            gripper_width_m=points.gripper_width_m,
        )
        match int(rng.integers(4)):
            case 0:
                kind, spoilt = spoil_envelope(command, rng, time_s)
                reply = self.attacker.ask(spoilt)
            case 1:
                kind, data = spoil_bytes(command, rng)
                reply = self.attacker.ask_bytes(data)
            case _:
                kind, wrong = spoil_points(points, rng, typed=False)
                reply = self.attacker.ask(
                    wire.Command(
                        command.session, command.epoch, command.sequence, command.expires_at_s,
                        wrong.q_rad, wrong.qd_rad_s, wrong.gripper_width_m,
                    )
                )  # fmt: skip
        self.tally.sent["wire"] += 1
        self.tally.kinds[kind] += 1
        if isinstance(reply, wire.Refused):
            self.tally.codes[f"target {reply.code}"] += 1
        else:
            self.tally.passed[f"wire: {kind}"] += 1
            handle._sequence += 1

    def repeat(self, recordings: Sequence[Recording], seeds: Sequence[int], count: int) -> None:
        """Every recorded session once more, with `count` hostile commands spread over them."""
        total = sum(len(each.commands) for each in recordings)
        due = _spread(count, total)
        for number, recording in enumerate(recordings):
            seed = seeds[number // len(CUBES)]
            self.handle.load(Scene(name=SCENE, seed=seed, episode=f"tidy-{seed}"))
            self.handle.begin(f"legitimate{number}", 1)
            for command, _ in recording.commands:
                points = SetPoints(command.q_rad, command.qd_rad_s, command.gripper_width_m)
                for _ in range(next(due)):
                    (self.attack_handle if self.rng.random() < 0.5 else self.attack_wire)(points)
                self.tally.legitimate += 1
                try:
                    self.handle.apply(points)
                except CommandRefused as refused:
                    self.tally.legitimate_refused += 1
                    self.tally.codes[f"legitimate: {refused.by} {refused.code}"] += 1
                    break
            self.handle.halt()
            self.handle.settle(SETTLE_S)
            self.handle.end()

    def drive_guarded(self, kind: str, count: int) -> None:
        """Motion at the limit through handle and guard."""
        number, open_session = 0, False
        q, qd, wanted = np.zeros(7), np.zeros(7), np.zeros(7)
        for index in range(count):
            if not open_session:
                number += 1
                if number % 10 == 1:
                    self.handle.load(Scene(name=SCENE, seed=1, episode=f"{kind} {number}"))
                seen = self.handle.begin(f"{kind} {number}", 1)
                live = self.handle.describe()
                q, qd = np.clip(seen.target.q_rad, live.q_min_rad, live.q_max_rad), np.zeros(7)
                open_session = True
            wanted = choose(kind, self.rng, index, self.attacker.velocity, wanted)
            rows = self.attacker.ramp(q, qd, 0.95 * wanted, share=1.0)
            self.tally.sent["driven, guarded"] += 1
            try:
                self.handle.apply(SetPoints(*rows, np.full(len(rows[0]), 0.08)))
            except CommandRefused as refused:
                self.tally.codes[f"{refused.by} {refused.code}"] += 1
                self.handle.end()
                open_session = False
            else:
                self.tally.accepted["driven, guarded"] += 1
                q, qd = rows[0][-1], rows[1][-1]
        if open_session:
            self.handle.end()

    def drive(self, kind: str, count: int) -> None:
        """Motion at the limit with nobody in between."""
        self.attacker.load()
        self.tally.sent["driven, bare wire"] += count
        self.tally.accepted["driven, bare wire"] += drive_hard(self.attacker, kind, self.rng, count)


def _spread(count: int, total: int) -> Iterator[int]:
    """How many go before each of `total`, so that they are `count` together."""
    for index in range(total):
        yield (index + 1) * count // total - index * count // total


def attack(
    folder: Path,
    robot: Robot,
    seeds: Sequence[int],
    recordings: Sequence[Recording],
    count: int,
    seed: int = 1,
) -> tuple[Tally, Seen]:
    """The whole campaign against one observed world process.

    Args:
        folder: Scratch.
        robot: The target.
        seeds: Of the scenes of the legitimate sessions.
        recordings: Those sessions, in order.
        count: Hostile commands.
        seed: Of what is hostile.

    Raises:
        ExecutionError: `TARGET_LOST` when the world did not live through it.
    """
    attacker = Attacker(folder, robot.profile)
    intruder = Intruder(attacker, robot, np.random.default_rng(seed))
    driven, guarded = (round(share * count / len(KINDS)) for share in (DRIVEN_SHARE, GUARDED_SHARE))
    try:
        intruder.repeat(recordings, seeds, count - (driven + guarded) * len(KINDS))
        for kind in KINDS:
            intruder.drive_guarded(kind, guarded)
        for kind in KINDS:  # these leave and come again, so the handle's connection is gone afterwards
            intruder.drive(kind, driven)
        return intruder.tally, attacker.finish()
    finally:
        attacker.kill()
