"""What a policy, its server, a wire to it and a bridge of its actions are written with.

    from phyagentos.policies import Infer, PolicyDescriptor, Start, serve_policy

    class Still:
        # Stays where it is.

        def start(self, request: Start) -> None: ...

        def infer(self, request: Infer) -> tuple[Array, bool]:
            return np.tile(request.observations["joint_state"], (25, 1)), False

    serve_policy(Still(), PolicyDescriptor.model_validate(...))

Entry point groups: `phyagentos.policy_wires`, a function `(endpoint, streams) -> PolicyService` under the scheme of its
endpoints, and `phyagentos.bridges`, a subclass of `ActionBridge`.
"""

from phyagentos.protocol.capabilities.action_spaces import ActionSpace
from phyagentos.protocol.capabilities.policy_descriptors import PolicyDescriptor, Stream
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.runtime.actions.bridges.bridge import ActionBridge, Frames, Unconvertible
from phyagentos.runtime.actions.bridges.chain import BridgeChain, compile_chain
from phyagentos.runtime.actions.violations import Intervention, Violation, ViolationCode
from phyagentos.runtime.policies.policy_server import Policy, answer, serve_policy
from phyagentos.runtime.policies.transport import PolicyService
from phyagentos.runtime.policies.wire import (
    Array,
    Chunk,
    Fault,
    Infer,
    Introduce,
    Introduction,
    Reply,
    Request,
    Start,
    Started,
)

__all__ = [
    "ActionBridge",
    "ActionSpace",
    "Array",
    "BridgeChain",
    "Chunk",
    "Fault",
    "Frames",
    "Infer",
    "Intervention",
    "Introduce",
    "Introduction",
    "Policy",
    "PolicyDescriptor",
    "PolicyService",
    "Reply",
    "Request",
    "Start",
    "Started",
    "Stream",
    "Unconvertible",
    "Violation",
    "ViolationCode",
    "answer",
    "compile_chain",
    "read_skill",
    "serve_policy",
]
