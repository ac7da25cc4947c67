"""What preflight grants: how a session will be executed, with which operations of the target. Paper section 3.4.

Upstream: preflight. Downstream: the runner and the evidence bundle.
"""

import msgspec


class AdapterPlan(msgspec.Struct, frozen=True, kw_only=True):
    """The resolved execution path of one session.

    Attributes:
        target_adapter: Who encodes commands for the target (`target_adapter://simulation/panda`).
        skill_runtime: Who produces them (`skillruntime://pick_and_place`).
        tree: Behaviour tree of a builtin skill.
        observation_path: What is sensed, in the order it travels.
        action_path: What is commanded, in the order it travels.
        action_bridges: Conversions between the two; empty when skill and target speak the same language.
        validation_mode: `strict`: nothing is repaired silently.
    """

    target_adapter: str
    skill_runtime: str
    tree: str
    observation_path: tuple[str, ...]
    action_path: tuple[str, ...]
    action_bridges: tuple[str, ...] = ()
    validation_mode: str = "strict"


class TargetToolManifest(msgspec.Struct, frozen=True, kw_only=True):
    """The operations of the target that the session may use; everything else is refused by the handle."""

    expose: tuple[str, ...]
    validation_mode: str = "strict"


EXPOSED_TOOLS = ("apply", "observe", "halt", "settle", "render")
