"""Skills that an agent directs, call by call: what it may call, and how often. Paper section 4.1."""

from typing import Any, Literal

import pydantic

from phyagentos.protocol.documents.schema import Authored


class AgentCall(Authored):
    """One decision of an agent.

    Attributes:
        call: `observe` the world as perceived; `invoke_tool`; `query_state`, whether a predicate is true; `wait` and
            hold still; `finish` with a claim, which is recorded and never believed.
        tool: Of `invoke_tool`, one of the session's tools.
        arguments: Of the tool.
        predicate: Of `query_state`.
        seconds: Of `wait`, of the target's time [s].
        claim: Of `finish`.
        reason: Why, in words.
        when: In a procedure, a predicate without whose truth the step is passed over.
    """

    call: Literal["observe", "invoke_tool", "query_state", "wait", "finish"]
    tool: str = ""
    arguments: dict[str, Any] = {}
    predicate: str = pydantic.Field(default="", max_length=1000)
    seconds: float = pydantic.Field(default=0.0, ge=0.0, le=60.0)
    claim: Literal["success", "failure"] = "success"
    reason: str = pydantic.Field(default="", max_length=1000)
    when: str = ""


class AgentLoop(Authored):
    """How an agent directs a session.

    Attributes:
        tools: Skills with a tree that it may invoke.
        calls: Most that it may make, refused ones included.
        procedure: Steps of the embedded agent; without any an outside one decides (`paos mcp`).
    """

    tools: tuple[str, ...] = pydantic.Field(min_length=1)
    calls: int = pydantic.Field(default=20, ge=1, le=1000)
    procedure: tuple[AgentCall, ...] = ()
