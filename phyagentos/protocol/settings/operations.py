"""The operations of a target: what a session may ask of it once it has authority.

Upstream: a target's profile says which it offers, a skill which it needs, runtime_contract.yaml which are permitted.
Downstream: preflight grants what all three agree on, as the TargetToolManifest. Paper section 4.2.
"""

from typing import Literal

Operation = Literal["apply", "observe", "halt", "settle", "render", "reset", "home"]
SESSION_OPERATIONS: tuple[Operation, ...] = ("apply", "observe", "halt", "settle", "render")
CORE_OPERATIONS: tuple[Operation, ...] = ("apply", "observe", "halt", "settle")  # no session can do without them
