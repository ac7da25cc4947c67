"""What a policy server states of itself: where it is, what it takes, how fast it answers. Paper section 4.3.

Preflight compares it with sensors, target and the server's own answer. Its commands are the skill's `action_space`.
"""

from collections.abc import Callable
from typing import Any, Literal

import pydantic

from phyagentos.plugins import Plugins
from phyagentos.protocol.capabilities.action_spaces import RotationForm
from phyagentos.protocol.documents.schema import Authored
from phyagentos.protocol.settings.operations import Operation
from phyagentos.protocol.settings.sensors import ElementType, Length, Modality

POLICY_PROTOCOL = 1  # version of the wire between a policy loop and its server
WORLD = "environment_state"  # a stream about objects, not about the robot
MODEL_SCHEME = "onnx"  # its endpoint is a file, run in this process
POLICY_WIRES = Plugins[Callable[..., Any]](
    "phyagentos.policy_wires",
    {
        **dict.fromkeys(("tcp", "http", "https"), "phyagentos.runtime.policies.client:open_own_wire"),
        **dict.fromkeys(("openpi", "openpis"), "phyagentos.runtime.policies.openpi_client:OpenpiService"),
        MODEL_SCHEME: "phyagentos.runtime.policies.client:open_model",
    },
)
"""What opens an endpoint, by its scheme: `open(endpoint, streams) -> PolicyService`, see `phyagentos.policies`."""
CLIENT_SIDE = frozenset({"endpoint", "execution", "heartbeat_s"})  # fields that no server states of itself


class Stream(Authored):
    """One observation that a policy takes.

    The last four fields say how it is shown over `openpi://` and to `onnx:`; over the other wires it goes as measured.

    Attributes:
        modality: What is measured.
        shape: Lengths of its axes; `n_joints` is the target's number of joints.
        dtype: Of its elements.
        unit: Of its elements, empty for none.
        frame: Frame of its measurements.
        rate_hz: How fresh it must be, and how far the samples of its history are apart [Hz].
        history: Samples that are shown at once, the oldest first, along a new first axis; 1 shows the present alone.
            Before there are so many, the oldest is repeated.
        key: Name that the model knows it by, its own without one; streams of one key are joined, in their order.
        resize: Height and width of a picture; the whole of it is shown, centred on black.
        turned: Whether a picture is turned by 180 degrees.
        entities: Of `environment_state`: the parameters of the skill that name the objects whose poses are shown.
        rotation: How the model writes the rotation of `tool_pose`, which is measured as w, x, y, z [rad].
    """

    modality: Modality
    shape: tuple[Length, ...] = ()
    dtype: ElementType = "float32"
    unit: str = ""
    frame: str = "world"
    rate_hz: float = pydantic.Field(gt=0)
    history: int = pydantic.Field(default=1, ge=1, le=100)
    key: str = ""
    resize: tuple[int, int] | None = None
    turned: bool = False
    entities: tuple[str, ...] = ()
    rotation: RotationForm = "quaternion_wxyz"


class PolicyExecution(Authored):
    """How chunks are carried out: what follows what, how old they may get, and what happens in between.

    Attributes:
        mode: How one chunk follows another. `hard_switch`: the next one takes over as soon as it comes.
            `receding_horizon`: it takes over at the horizon, never before. `open_loop`: each chunk is carried out to
            its last row before the next one is asked for. `temporal_ensemble`: a new one is asked for at each horizon,
            and what is carried out is the weighted mean of all that speak of the same moment (Zhao et al. 2023,
            arXiv:2304.13705).
        horizon: Rows of each chunk, at the policy's own rate, that are carried out until the next one is to take over.
            Without it all but the last four control periods; one row in a `temporal_ensemble`. None in `open_loop`.
        ensemble_decay: m of the weights exp(-m i) of a `temporal_ensemble`, where i = 0 is the oldest chunk.
        expiry_s: Age, from its observation on, beyond which no row of a chunk is commanded any more, in the target's
            time [s]. Without it a chunk ends with its last row.
        underrun: Where time goes on and rows run out before the next chunk is there. `wait`: nothing is commanded, the
            target holds by its own means. `brake`: the arm is brought to rest on a ramp. `continue`: the rows beyond
            the horizon are carried out, then it brakes. `fail`: the session ends with `POLICY_LOST`. A
            `temporal_ensemble` carries out its rows beyond the horizon in any case.
        interruption: Where `paos pause` takes hold: after the present control period (`row`), or at the next horizon
            (`chunk`). The arm then brakes on a ramp, and the policy is shown what there is to see when it goes on.
        duration_s: Commanded time after which the policy counts as done, for those that never say so [s].
        until_met_s: Interval at which the acceptance of the session is looked at, in the target's time; once it holds,
            the arm is brought to rest and the policy counts as done [s]. The verdict rests on a look after that.
        begins_after: A skill that comes before another attempt: it brings the body to where demonstrations began.
        aim: The parameter, a point, by which the first object of `environment_state` is shown aside [m]. Another
            attempt is given what the tool has missed it by.
    """

    mode: Literal["hard_switch", "receding_horizon", "open_loop", "temporal_ensemble"] = "hard_switch"
    horizon: int | None = pydantic.Field(default=None, ge=1)
    ensemble_decay: float = pydantic.Field(default=0.01, ge=0.0)
    expiry_s: float | None = pydantic.Field(default=None, gt=0.0)
    underrun: Literal["wait", "brake", "continue", "fail"] = "wait"
    interruption: Literal["row", "chunk"] = "chunk"
    duration_s: float | None = pydantic.Field(default=None, gt=0.0)
    until_met_s: float | None = pydantic.Field(default=None, gt=0.0)
    begins_after: str = ""
    aim: str = ""


class PolicyDescriptor(Authored):
    """One policy server.

    Attributes:
        policy: Name and version of the policy.
        protocol: Version of the wire.
        endpoint: Where it listens: `tcp://127.0.0.1:5555`, `http://...`, `openpi://host:port` (`openpis://` with TLS;
            `?actions=KEY` where chunks have another key), or `onnx:FILE` beside SKILL.md, which is run in this process.
        observations: What it takes, by the names that targets and sensors use.
        inference_s: Longest time from an observation to its chunk [s].
        operations: Operations of the target that it uses besides commands.
        execution: How its chunks are carried out.
        heartbeat_s: Longest silence of the server, by the wall [s]: it is probed between requests, and in the midst of
            one it may take `inference_s` longer to give a sign of life. Without it only `policy_s` counts.
    """

    policy: str
    protocol: int = POLICY_PROTOCOL
    endpoint: str
    observations: dict[str, Stream]
    inference_s: float = pydantic.Field(gt=0)
    operations: tuple[Operation, ...] = ()
    execution: PolicyExecution = PolicyExecution()
    heartbeat_s: float | None = pydantic.Field(default=None, gt=0.0)
