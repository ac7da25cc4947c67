"""What a policy server states of itself: where it is, what it takes, how fast it answers. Paper section 4.3.

Preflight compares it with sensors, target and the server's own answer. Its commands are the skill's `action_space`.
"""

import pydantic

from phyagentos.protocol.documents.schema import Authored
from phyagentos.protocol.settings.operations import Operation
from phyagentos.protocol.settings.sensors import ElementType, Length, Modality

POLICY_PROTOCOL = 1  # version of the wire between a policy loop and its server
SCHEMES = ("tcp", "http", "https")  # of endpoints


class Stream(Authored):
    """One observation that a policy takes.

    Attributes:
        modality: What is measured.
        shape: Lengths of its axes; `n_joints` is the target's number of joints.
        dtype: Of its elements.
        unit: Of its elements, empty for none.
        frame: Frame of its measurements.
        rate_hz: How fresh it must be [Hz].
    """

    modality: Modality
    shape: tuple[Length, ...] = ()
    dtype: ElementType = "float32"
    unit: str = ""
    frame: str = "world"
    rate_hz: float = pydantic.Field(gt=0)


class PolicyDescriptor(Authored):
    """One policy server.

    Attributes:
        policy: Name and version of the policy.
        protocol: Version of the wire.
        endpoint: Where it listens (`tcp://127.0.0.1:5555`, `http://...`).
        observations: What it takes, by the names that targets and sensors use.
        inference_s: Longest time from an observation to its chunk [s].
        operations: Operations of the target that it uses besides commands.
    """

    policy: str
    protocol: int = POLICY_PROTOCOL
    endpoint: str
    observations: dict[str, Stream]
    inference_s: float = pydantic.Field(gt=0)
    operations: tuple[Operation, ...] = ()
