"""Composites of a tree in a running session: beside each other, again, under a condition."""

import msgspec
import numpy as np

from phyagentos.protocol.sessions.evidence import read_bundle
from phyagentos.protocol.sessions.session import Ended


def test_a_branch_that_moves_stands_still_while_the_one_beside_it_thinks(build_bench, session, plant, doubles):
    tree = "parallel: {children: [move_home, {sequence: {children: [{wait: {seconds: 0.1}}, close_gripper]}}]}"
    commands = []
    for polls in (0, 40):
        bench = build_bench(library=plant([tree]), planner=doubles.ScriptedPlanner(polls=polls))
        bench.target.q = bench.target.q + 0.3
        assert bench.run(session).ended is Ended.COMPLETED
        commands.append(bench.target.commands())

    arms = [np.vstack([command.q_rad for command in each]) for each in commands]
    grippers = [np.concatenate([command.gripper_width_m for command in each]) for each in commands]
    assert np.array_equal(*arms)
    assert np.array_equal(*grippers)
    assert grippers[0].min() == 0.0
    assert grippers[0].max() > 0.0


def test_a_retry_runs_the_child_again_and_the_trace_shows_each_attempt(build_bench, session, plant):
    bench = build_bench(library=plant(["retry: {attempts: 3, child: {fail: {code: NOPE}}}"]))
    execution = bench.run(session)

    assert (execution.code, execution.leaf) == ("NOPE", "planted/retry/fail")
    trace = read_bundle(bench.workspace / execution.evidence, session, execution).trace
    assert [(event.status, event.code) for event in trace if event.leaf == "fail"] == [("FAILURE", "NOPE")] * 3


def test_a_condition_reads_the_world_through_keys_of_the_tree(build_bench, session, plant):
    header = "inputs: {object: {type: entity}}\n"
    children = ['condition: "exists(${object})"', 'invert: {child: {condition: "holding(target, ${object})"}}']
    bench = build_bench(library=plant(children, header))

    assert bench.run(msgspec.structs.replace(session, parameters={"object": "red_cube"})).ended is Ended.COMPLETED
    absent = bench.run(msgspec.structs.replace(session, id="tidy-1.b", parameters={"object": "cup"}))
    assert (absent.code, absent.leaf) == ("UNMET", "planted/condition")
    assert "exists(cup) is false" in absent.message


def test_home_is_planned_with_what_the_fingers_hold_though_no_port_names_it(
    build_bench, session, plant, doubles, profile
):
    """The held object was an obstacle in contact with the fingers: the arm found no way out of its own hand."""
    target = doubles.PerfectTarget(profile, [doubles.make_cube()], graspable="red_cube")
    target.q = target.q_d = target.q + 0.1
    bench = build_bench(target, planner := doubles.ScriptedPlanner(), library=plant(["close_gripper", "move_home"]))
    bench.run(session)
    assert [request.payload.entity for request in planner.requests] == ["red_cube"]


def test_a_reactive_sequence_judges_its_condition_each_period_and_the_trace_shows_its_changes_alone(
    build_bench, session, plant, doubles, profile
):
    """`exists` fails once the cube is gone: the arm that moves beside it is stopped within a period."""
    tree = 'reactive_sequence: {children: [{condition: "exists(red_cube)"}, {wait: {seconds: 9}}]}'
    target = doubles.PerfectTarget(profile, [doubles.make_cube()])
    bench = build_bench(target, library=plant([tree]))
    carry_out = target._carry_out

    def take_away(request):
        if len(target.commands()) == 20:
            target.entities = {}
        return carry_out(request)

    target._carry_out = take_away
    execution = bench.run(session)
    assert (execution.code, execution.leaf) == ("UNMET", "planted/reactive_sequence/condition")
    assert len(target.commands()) == 20
    trace = read_bundle(bench.workspace / execution.evidence, session, execution).trace
    assert [event.status for event in trace if event.leaf == "condition"] == ["SUCCESS", "FAILURE"]
