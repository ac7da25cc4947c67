"""LIBERO's tasks with moments that the world's own hand makes: their goals met, and missed in many ways.

    python -m benchmarks.libero_parts.moments < KEY_AND_SETTINGS      # as of target_server.libero_body

The served body has one more tool, `make_moment`. It begins at the initial state of the episode, puts things somewhere,
or joints, and lets physics go on until they rest. What was meant is no label: whether the goal is met says the
benchmark's predicate at the end of the session that looks at it, as of any session. `met` is drawn until it says so.
"""

import contextlib
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
from target_server.body import Entity
from target_server.libero_body import STEP_S, LiberoBody, Settings
from target_server.mujoco_things import Thing
from target_server.server import main
from target_server.wire import Refusal

from benchmarks.libero_parts.hand import AT_EDGE, WITHIN, Crowded, Hand, Rng

REST_STEPS, MORE_STEPS = 12, 8  # after things were let go; a few times more while they still move
HOLDS = 5  # times in a step of the environment that the arm is put back
TRIES = 6  # draws of a whole moment, until the goal is met
SHORT = (0.002, 0.2)  # of a travel, by which a joint misses its end
PUTS, OPENS, CLOSES = ("on", "in"), ("open", "turnon"), ("close", "turnoff")


class MomentsBody(LiberoBody):
    """The robot of a task, in a world in which things can be put."""

    def __init__(self, settings: Settings) -> None:
        self._unseen: dict[str, Entity] = {}
        super().__init__(settings)
        self.tools = {**self.tools, "make_moment": self._make_moment}
        self._kinds: dict[str, Callable[[Rng], bool]] = {
            "start": lambda rng: True,
            "met": self._meet,
            "dropped": self._drop,
            "near miss": self._miss_narrowly,
            "wrong object": self._take_wrong,
            "elsewhere": self._put_elsewhere,
            "half of it": self._meet_half,
            "joint short of its end": self._stop_short,
            "covered": self._cover,
            "occluded": self._hide,
        }

    def load(self, scene: str, seed: int, snapshot: bytes) -> None:
        """Begin an episode, and keep its beginning."""
        super().load(scene, seed, snapshot)
        self._unseen = {}
        self._hand = Hand(self._model, self._data, self._things)
        self._start = np.empty(mujoco.mj_stateSize(self._model, mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_getState(self._model, self._data, self._start, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._goal: list[list[str]] = [
            [each[0].lower(), *each[1:]] for each in self._env.env.parsed_problem["goal_state"]
        ]

    def list_entities(self) -> Sequence[Entity]:
        """As the world is, but for things that are hidden: where they were last seen."""
        return [self._unseen.get(each.name, each) for each in super().list_entities()]

    def stay(self) -> None:
        """One step by physics alone: the arm stands as under brakes, whatever touches it. No session commands it."""
        q_rad = self._data.qpos[self._q_at].copy()
        for _ in range(HOLDS):
            mujoco.mj_step(self._model, self._data, round(STEP_S / self._model.opt.timestep) // HOLDS)
            self._data.qpos[self._q_at], self._data.qvel[self._qd_at] = q_rad, 0.0
        mujoco.mj_forward(self._model, self._data)
        self._steps += 1

    def _make_moment(self, arguments: Mapping[str, Any]) -> dict[str, tuple[str, bytes]]:
        """Make one; tells whether the task can have one of this kind."""
        kind, rng = str(arguments["kind"]), np.random.default_rng(int(arguments["seed"]))
        if kind not in self._kinds:
            raise Refusal("MALFORMED", f"no moment {kind!r}; there are {', '.join(self._kinds)}")
        made = any(self._try(kind, rng) for _ in range(TRIES))
        return {"moment.json": ("application/json", json.dumps({"made": made}).encode())}

    def _try(self, kind: str, rng: Rng) -> bool:
        """Whether one was made, and physics went well."""
        self._begin()
        with contextlib.suppress(Crowded):
            if self._kinds[kind](rng):
                self._settle()
                return self._hand.is_sound()
        return False

    def _begin(self) -> None:
        self._unseen = {}
        mujoco.mj_setState(self._model, self._data, self._start, mujoco.mjtState.mjSTATE_INTEGRATION)
        for each in self._data.warning:
            each.number = 0
        mujoco.mj_forward(self._model, self._data)
        self._rest()

    def _meet(self, rng: Rng) -> bool:
        """All effects; drawn again while the benchmark does not say so."""
        for _ in range(TRIES):
            self._begin()
            with contextlib.suppress(Crowded):
                self._bring_about(self._goal, rng)
                self._settle()
                if self._env.check_success() and self._hand.is_sound():
                    return True
        return self._hand.is_sound()

    def _drop(self, rng: Rng) -> bool:
        """One thing of the goal met lies beside its place, wherever it fell."""
        if not (puts := self._list_puts()):
            return False
        self._bring_about(self._goal, rng)
        self._let_fall(puts[rng.integers(len(puts))], rng)
        return True

    def _miss_narrowly(self, rng: Rng) -> bool:
        """One thing was let go at the edge of its place."""
        if not (puts := self._list_puts()):
            return False
        missed = puts[rng.integers(len(puts))]
        self._bring_about([each for each in self._goal if each is not missed], rng)
        self._hand.put(self._hand.get(missed[1]), self._hand.find_spot(missed[2]), rng, AT_EDGE)
        return True

    def _take_wrong(self, rng: Rng) -> bool:
        """Another thing is where one should be, or another joint moved; the right one is as it was."""
        missed = self._goal[rng.integers(len(self._goal))]
        rest = [each for each in self._goal if each is not missed]
        self._bring_about(rest, rng)
        if missed[0] in PUTS:
            others = self._list_others()
            if others:
                self._hand.put(others[rng.integers(len(others))], self._hand.find_spot(missed[2]), rng, WITHIN)
            return bool(others)
        right = self._hand.find_mechanism(missed[1])
        joints = [each for each in self._things if each.joint and each is not right]
        if joints:
            other = joints[rng.integers(len(joints))]
            self._hand.move(other, *((0.9, 1.0) if missed[0] in OPENS else (0.0, 0.002)), rng)
        return bool(joints)

    def _put_elsewhere(self, rng: Rng) -> bool:
        """One thing is in, or on, something else of the scene: the other drawer, the other plate."""
        puts = self._list_puts()
        wanted = {each[2] for each in puts} | {each[1] for each in puts}
        marks = [mark.name for thing in self._things for mark in thing.marks]
        names = [each for each in (*marks, *(thing.name for thing in self._hand.list_free())) if each not in wanted]
        if not puts or not names:
            return False
        missed = puts[rng.integers(len(puts))]
        self._bring_about([each for each in self._goal if each is not missed], rng)
        self._hand.put(self._hand.get(missed[1]), self._hand.find_spot(names[rng.integers(len(names))]), rng, WITHIN)
        return True

    def _meet_half(self, rng: Rng) -> bool:
        """All but one effect of several."""
        missed = int(rng.integers(len(self._goal)))
        self._bring_about([each for index, each in enumerate(self._goal) if index != missed], rng)
        return len(self._goal) > 1

    def _stop_short(self, rng: Rng) -> bool:
        """A joint is about where it begins to count."""
        joints = [each for each in self._goal if each[0] not in PUTS]
        if not joints:
            return False
        self._bring_about(self._goal, rng)
        missed = joints[rng.integers(len(joints))]
        thing = self._hand.find_mechanism(missed[1])
        end, sign = (self._find_end(thing, missed[0]), -1.0 if missed[0] in OPENS else 1.0)
        self._hand.move(thing, *sorted(end + sign * by for by in SHORT), rng)
        return True

    def _cover(self, rng: Rng) -> bool:
        """Another thing was put down on one thing of the goal met."""
        puts, others = self._list_puts(), self._list_others()
        if not puts or not others:
            return False
        self._meet(rng)
        under = self._hand.get(puts[rng.integers(len(puts))][1])
        self._hand.put(others[rng.integers(len(others))], self._hand.find_spot(under.name), rng, WITHIN)
        return True

    def _hide(self, rng: Rng) -> bool:
        """The goal was met and seen; then a thing was hidden from view, and half of them were taken away unseen."""
        self._meet(rng)
        hidden = self._goal[rng.integers(len(self._goal))]
        thing = self._hand.get(hidden[1]) if hidden[0] in PUTS else self._hand.find_mechanism(hidden[1])
        seen = next(each for each in self.list_entities() if each.name == thing.name)
        if rng.random() < 0.5 and hidden[0] in PUTS:
            self._let_fall(hidden, rng)
        elif rng.random() < 0.5 and hidden[0] not in PUTS:
            self._hand.move(thing, 0.2, 0.8, rng)
        self._unseen = {seen.name: replace(seen, more={**seen.more, "visible": False})}
        return True

    def _bring_about(self, effects: Sequence[Sequence[str]], rng: Rng) -> None:
        """Joints first, and what bears things before these."""
        for head, name, *_ in (each for each in effects if each[0] not in PUTS):
            thing = self._hand.find_mechanism(name)
            end = self._find_end(thing, head)
            self._hand.move(thing, *((end, 1.0) if head in OPENS else (0.0, end)), rng)
        puts = [each for each in effects if each[0] in PUTS]
        placed = {each[1] for each in puts}
        for _, name, place in sorted(puts, key=lambda each: each[2] in placed):
            self._hand.put(self._hand.get(name), self._hand.find_spot(place), rng, WITHIN)

    def _let_fall(self, put: Sequence[str], rng: Rng) -> None:
        self._hand.let_fall(self._hand.get(put[1]), self._hand.find_spot(put[2]), rng)

    def _settle(self) -> None:
        """Let time pass until nothing moves, the arm held where it is."""
        for steps in (REST_STEPS, MORE_STEPS, MORE_STEPS, MORE_STEPS):
            for _ in range(steps):
                self.stay()
            if self._hand.is_still():
                break

    def _find_end(self, thing: Thing, head: str) -> float:
        """The share of its travel at which a joint begins to count."""
        ends = self._ends[thing.name]
        return ends.get("opens_at", 0.9) if head in OPENS else ends.get("closes_at", 0.1)

    def _list_puts(self) -> list[list[str]]:
        return [each for each in self._goal if each[0] in PUTS]

    def _list_others(self) -> list[Thing]:
        """Free things that the goal does not name."""
        named = {name for each in self._goal for name in each[1:]}
        owners = {thing.name for thing in self._things for mark in thing.marks if mark.name in named}
        return [each for each in self._hand.list_free() if each.name not in named | owners]


def make_body() -> MomentsBody:
    """As the settings on the second line of standard input say."""
    return MomentsBody(Settings(**json.loads(sys.stdin.readline())))


if __name__ == "__main__":
    main(make_body)
