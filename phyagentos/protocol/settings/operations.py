"""The operations of a target. Paper section 4.2.

A session may use those that the target offers, its skill needs and runtime_contract.yaml permits.
"""

from typing import Literal

Operation = Literal["apply", "observe", "halt", "settle", "render", "reset", "home"]
SESSION_OPERATIONS: tuple[Operation, ...] = ("apply", "observe", "halt", "settle", "render")
CORE_OPERATIONS: tuple[Operation, ...] = ("apply", "observe", "halt", "settle")  # no session can do without them
