"""A game of NetHack by the settings of BALROG (github.com/balrog-ai/BALROG, balrog/config/config.yaml, af7d1f17).

`NetHackChallenge-v0` with `character: "@"` (role, race and the rest by chance), 100 000 steps at most, an end after 150
steps without a turn of the game, and `--More--` answered by itself, which counts as steps too. Two settings differ: the
seed is given, where BALROG draws it, and the phase of the moon follows it, so that keys repeat a game.

What is kept of it is what the screen shows a player; `depth` and `level` are the deepest and highest so far.
"""

import re
from typing import Any

import numpy as np
from nle import nethack
from nle.env.base import NLE
from nle.env.tasks import NetHackChallenge

BALROG = {"character": "@", "max_episode_steps": 100_000, "no_progress_timeout": 150, "save_ttyrec_every": 0}
MORE, ESCAPE = "\r", "\x1b"
_SEEDING = ("set_initial_seeds", "set_current_seeds", "get_current_seeds")  # closed by the challenge
_END = re.compile(
    r"Agent-\S+ (.+?) in (?:The|Sokoban|Fort|Vlad|Gehennom)\b.*? on level \d+(?: \[max \d+\])?\.(?: (.+?\.))?"
)


class Game:
    """One game, from its seed.

    Attributes:
        glyphs: (21, 79) what the map shows, `nle`'s numbers.
        message: What was said since the last key.
        is_over: Whether it has ended; `end` says how.
        keys: Pressed so far, by the action, those for `--More--` left out; `steps` counts all.
    """

    def __init__(self, seed: int) -> None:
        self._env = NetHackChallenge(savedir=None, fix_moon_phase=True, **BALROG)
        for name in _SEEDING:
            delattr(self._env.nethack, name)
        NLE.seed(self._env, seed, seed, reseed=False)
        self._codes = {chr(int(each)): n for n, each in reversed([*enumerate(self._env.actions)])}
        self.keys, self.steps, self.is_over, self.end = list[str](), 0, False, ""
        self.depth = self.level = 1
        self._note(self._env.reset()[0])
        self.is_at_home = any(race in self.message for race in ("dwarv", "dwarf", "gnom"))

    def press(self, keys: str) -> None:
        """Keys, one after the other, and all that follows without a choice."""
        self.keys.append(keys)
        self.message = ""
        for key in keys:
            self._step(key)
            while self._waits and not self.is_over:
                self._step(MORE)

    def _step(self, key: str) -> None:
        if self.is_over:
            return
        seen, _, is_over, is_cut, _ = self._env.step(self._codes[key])
        self.steps += 1
        self.is_over = bool(is_over or is_cut)
        if self.is_over:
            screen = " ".join(" ".join(bytes(row).decode("latin-1") for row in seen["tty_chars"]).split())
            found = _END.search(screen)
            self.end = " ".join(each for each in found.groups() if each) if found else "no more steps"
        else:
            self._note(seen)

    def _note(self, seen: Any) -> None:
        self.glyphs = np.array(seen["glyphs"])
        stats = seen["blstats"]
        said = bytes(seen["message"]).rstrip(b"\0").decode("latin-1")
        self.message = f"{getattr(self, 'message', '')} {said}".strip()
        self.at = (int(stats[nethack.NLE_BL_X]), int(stats[nethack.NLE_BL_Y]))
        self.health, self.health_max = int(stats[nethack.NLE_BL_HP]), int(stats[nethack.NLE_BL_HPMAX])
        self.hunger, self.turn = int(stats[nethack.NLE_BL_HUNGER]), int(stats[nethack.NLE_BL_TIME])
        self.place = (int(stats[nethack.NLE_BL_DNUM]), int(stats[nethack.NLE_BL_DEPTH]))
        self.depth = max(self.depth, self.place[1])
        self.level = max(self.level, int(stats[nethack.NLE_BL_XP]))
        self._waits, self.is_asked = bool(seen["misc"][2]), bool(seen["misc"][0] or seen["misc"][1])
        rows = zip(seen["inv_letters"], seen["inv_oclasses"], map(bytes, seen["inv_strs"]), strict=True)
        self.items = {
            chr(letter): (int(kind), row.rstrip(b"\0").decode("latin-1")) for letter, kind, row in rows if letter
        }
