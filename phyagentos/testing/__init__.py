"""Doubles and checks for tests of extensions, by anyone who writes one.

    from phyagentos.testing import SkillStand, make_cube

    def test_it_names_the_nearest_cube(tmp_path):
        stand = SkillStand(tmp_path, entities=[make_cube("near"), make_cube("far", (0.9, 0.0, 0.02))])
        ran = stand.run_leaf(ChooseNearest, kind="cube")
        assert (ran.status, ran.outputs) == ("SUCCESS", {"object": "near"})

`check_leaf`, `check_predicate`, `check_judge` and each of `DRIVER_CHECKS` is what a leaf, predicate, judge or driver
has to satisfy, and raises AssertionError. A name is loaded when it is first used.
"""

from typing import TYPE_CHECKING

__all__ = [
    "DRIVER_CHECKS",
    "DirectConnection",
    "DriverClient",
    "DriverSubject",
    "LeafRun",
    "ManualClock",
    "PerfectTarget",
    "ReachedTarget",
    "ScriptedPlanner",
    "SkillStand",
    "check_judge",
    "check_leaf",
    "check_predicate",
    "compute_answer",
    "compute_line",
    "make_contract",
    "make_cube",
    "make_tray",
    "make_world",
    "read_robot",
    "refuse",
]

if TYPE_CHECKING:
    from phyagentos.testing.doubles import (
        DirectConnection,
        PerfectTarget,
        ScriptedPlanner,
        compute_answer,
        compute_line,
        refuse,
    )
    from phyagentos.testing.driver_checks import DRIVER_CHECKS, DriverClient, DriverSubject, ReachedTarget
    from phyagentos.testing.judge_checks import check_judge
    from phyagentos.testing.leaf_checks import check_leaf
    from phyagentos.testing.manual_clock import ManualClock
    from phyagentos.testing.predicate_checks import check_predicate
    from phyagentos.testing.skill_stand import LeafRun, SkillStand, read_robot
    from phyagentos.testing.worlds import make_contract, make_cube, make_tray, make_world
else:

    def __getattr__(name: str) -> object:
        from importlib import import_module

        homes = {
            "doubles": "DirectConnection PerfectTarget ScriptedPlanner compute_answer compute_line refuse",
            "driver_checks": "DRIVER_CHECKS DriverClient DriverSubject ReachedTarget",
            "judge_checks": "check_judge",
            "leaf_checks": "check_leaf",
            "manual_clock": "ManualClock",
            "predicate_checks": "check_predicate",
            "skill_stand": "LeafRun SkillStand read_robot",
            "worlds": "make_contract make_cube make_tray make_world",
        }
        home = next((module for module, names in homes.items() if name in names.split()), None)
        if home is None:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f"{__name__}.{home}"), name)
