"""Failure codes of the leaves that ship; plug-ins may add their own. A code names what was found, not what to do."""

from enum import StrEnum


class FailureCode(StrEnum):
    """Coded reasons of the leaves that ship."""

    OBJECT_GONE = "OBJECT_GONE"
    """The object is not in the believed world."""
    NOT_VISIBLE = "NOT_VISIBLE"
    """The object is believed, but was not seen."""
    GRASP_MISSED = "GRASP_MISSED"
    """The fingers closed and do not hold the object."""
    GRASP_LOST = "GRASP_LOST"
    """The object was held and is not any more."""
    STILL_HELD = "STILL_HELD"
    """The fingers opened and still hold the object."""
    STALLED = "STALLED"
    """A motor does not follow its set-points."""
    OUT_OF_TIME = "OUT_OF_TIME"
    """A timeout of the tree ran out, in simulated time."""
    UNMET = "UNMET"
    """A condition of the tree is false or unknown."""
    PLANNER_LOST = "PLANNER_LOST"
    """The planner process died or broke its protocol."""
    NOT_AT_START = "NOT_AT_START"
    """A motion does not begin where the arm stands."""
    NO_PROGRESS = "NO_PROGRESS"
    """The tree runs, yet neither commands nor thinks."""
