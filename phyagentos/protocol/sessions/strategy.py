"""The strategy of a session: what a skill does differently from its own way.

On disk its keys are the fields' names; what is not done differently is left out.
"""

import re
from typing import NamedTuple

import msgspec

from phyagentos.wording import format_share

_TURN = re.compile(r"\byaw([+-]\d+)")


def format_label(label: str) -> str:
    """The label of a grasp or a site as people read it: `site4.yaw 90°`."""
    return _TURN.sub(lambda found: f"yaw {int(found[1])}°", label)


class SiteLabel(NamedTuple):
    """A way to put something down: the site, and how the hand comes to it."""

    site: str
    approach: str

    def __str__(self) -> str:
        """`site4.yaw+090`."""
        return f"{self.site}.{self.approach}"

    @classmethod
    def parse(cls, label: str) -> "SiteLabel":
        """What a label of a trace or a strategy names; one of a site alone names any approach."""
        site, _, approach = label.partition(".")
        return cls(site, approach)


class Strategy(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Choices of one session; a strategy without any is false.

    Attributes:
        avoid_grasps: Labels of grasps that are left out.
        avoid_sites: Sites, or ways to one of them (`<site>.<yaw>`), that are left out.
        speed: Fraction of the skill's own speed.
    """

    avoid_grasps: tuple[str, ...] = ()
    avoid_sites: tuple[str, ...] = ()
    speed: float = 1.0

    @property
    def changed(self) -> frozenset[str]:
        """Names of the fields in which it differs from the skill's own way."""
        return frozenset(
            name for name in self.__struct_fields__ if getattr(self, name) != getattr(DEFAULT_STRATEGY, name)
        )

    def __bool__(self) -> bool:
        """Whether anything is done differently."""
        return self != DEFAULT_STRATEGY

    def __str__(self) -> str:
        """`with another grasp (not yaw 0°) at half speed`; empty when nothing is done differently."""
        shown = (("with another grasp", self.avoid_grasps), ("at another site", self.avoid_sites))
        parts = [f"{name} (not {' or '.join(map(format_label, labels))})" for name, labels in shown if labels]
        slow = "at half speed" if self.speed == 0.5 else f"at {format_share(self.speed)} of the speed"
        return " ".join(parts if self.speed == DEFAULT_STRATEGY.speed else [*parts, slow])

    def avoid(self, *, grasp: str = "", site: str = "") -> "Strategy":
        """The same, without this grasp or this site."""
        return self.join(Strategy(avoid_grasps=(grasp,) if grasp else (), avoid_sites=(site,) if site else ()))

    def slow_down(self, factor: float, slowest: float) -> "Strategy":
        """The same at a fraction of its speed, at least `slowest` of the skill's own."""
        return msgspec.structs.replace(self, speed=max(slowest, self.speed * factor))

    def avoid_nothing(self) -> "Strategy":
        """The same, every grasp and site allowed."""
        return Strategy(speed=self.speed)

    def join(self, other: "Strategy") -> "Strategy":
        """Both: everything that either avoids, and the own speed where that is not the skill's."""
        return Strategy(
            avoid_grasps=tuple(dict.fromkeys((*self.avoid_grasps, *other.avoid_grasps))),
            avoid_sites=tuple(dict.fromkeys((*self.avoid_sites, *other.avoid_sites))),
            speed=self.speed if self.speed != DEFAULT_STRATEGY.speed else other.speed,
        )


DEFAULT_STRATEGY = Strategy()
"""The skill's own way."""
