"""What every policy has to satisfy before a robot follows it."""

from pathlib import Path

import numpy as np

from phyagentos.protocol.capabilities.action_spaces import describe_target_space
from phyagentos.protocol.capabilities.skill_runtimes import read_skill
from phyagentos.runtime.actions.bridges.chain import BridgeChain, Bridged, compile_chain
from phyagentos.runtime.actions.bridges.tool_poses import describe_frames
from phyagentos.runtime.policies.policy_server import Policy
from phyagentos.runtime.policies.wire import Array, Infer, Start
from phyagentos.testing.skill_stand import ROBOT, read_robot


def check_policy(policy: Policy, skill_file: Path, robot: str = ROBOT, chunks_max: int = 100) -> list[Array]:
    """Run a policy without a server on a robot that follows it exactly; its chunks until it says that it is done.

    `skill_file` is the SKILL.md that declares it. Raises AssertionError where a chunk is not what the skill's action
    space says, or where its bridges to the robot refuse it.
    """
    skill, profile = read_skill(skill_file)[0], read_robot(robot)[0]
    assert skill.policy is not None, f"{skill_file} declares no policy"
    target = describe_target_space(profile)
    source = skill.action_space or target
    chain = compile_chain(source, target, describe_frames(profile))
    assert isinstance(chain, BridgeChain), f"no bridges to {robot}: {chain}"
    known = {"joint_state": np.array(profile.arm.home_rad), "gripper_width": np.array(profile.gripper.max_width_m)}
    shapes = {
        name: [len(profile.arm.joints) if each == "n_joints" else int(each) for each in stream.shape]
        for name, stream in skill.policy.observations.items()
    }
    before, chunks = np.append(known["joint_state"], known["gripper_width"])[: target.width], list[Array]()
    policy.start(Start(session="g.a", instruction="", parameters={}, seed=0))
    while len(chunks) < chunks_max:
        seen = {name: known.get(name, np.zeros(shape)) for name, shape in shapes.items()}
        done = sum(map(len, chunks))
        rows, is_last = policy.infer(
            Infer(session="g.a", sequence=len(chunks), rows_done=done, time_s=0.0, observations=seen)
        )
        bridged = chain.apply(np.asarray(rows, dtype=np.float64), before)
        assert isinstance(bridged, Bridged), f"chunk {len(chunks)}: {bridged}"
        chunks.append(rows)
        before = bridged.rows[-1]
        known["joint_state"] = before[: len(profile.arm.joints)]
        if is_last:
            break
    return chunks
