"""A draft spares time and changes nothing: what runs is the session that was ordered, in the world as it stands."""

import msgspec
import numpy as np

from phyagentos.protocol.sessions import Ended
from phyagentos.runtime import drafts
from phyagentos.runtime.targets import wire

PLAN = {"tree": "home"}


def count_trees(monkeypatch) -> list[str]:
    built: list[str] = []
    build = drafts.build_tree

    def note(name, *rest):
        built.append(name)
        return build(name, *rest)

    monkeypatch.setattr(drafts, "build_tree", note)
    return built


def make_home(build_session, **changes):
    return build_session(skill="home", parameters={}, **changes)


def test_a_drafted_session_runs_from_where_the_target_rests_then(build_bench, build_session, monkeypatch):
    bench, session, built = build_bench(), make_home(build_session), count_trees(monkeypatch)
    bench.handle.load(session.scene)
    bench.runner.draft(session, PLAN)
    bench.target.q = bench.target.q + 0.3
    begins = bench.target.q.copy()

    execution = bench.run(session)

    assert execution.ended is Ended.COMPLETED
    assert built == ["home"]
    assert np.abs(bench.target.commands()[0].q_rad[0] - begins).max() < 0.01


def test_a_draft_asks_the_target_for_nothing_that_needs_authority(build_bench, build_session):
    bench, session = build_bench(), make_home(build_session)
    bench.handle.load(session.scene)
    bench.target.requests.clear()

    bench.runner.draft(session, PLAN)

    assert {type(request) for request in bench.target.requests} <= {wire.Describe}


def test_a_draft_of_another_contract_is_not_used(build_bench, build_session, monkeypatch):
    bench, session, built = build_bench(), make_home(build_session), count_trees(monkeypatch)
    bench.handle.load(session.scene)
    bench.runner.draft(session, PLAN)
    bench.runner.draft(make_home(build_session, id="tidy-1.other"), PLAN)

    amended = msgspec.structs.replace(session, priority=3)
    execution = bench.run(amended)

    assert execution.ended is Ended.COMPLETED
    assert built == ["home", "home", "home"]


def test_what_is_wrong_with_a_tree_is_told_by_the_session_not_by_its_draft(build_bench, session, plant):
    bench = build_bench(library=plant(["locat"]))
    bench.handle.load(session.scene)

    bench.runner.draft(session, {"tree": "planted"})
    execution = bench.run(session)

    assert (execution.ended, execution.code) == (Ended.SKILL_FAILED, "TREE_INVALID")


def test_a_target_that_was_described_anew_gets_a_fresh_draft(build_bench, build_session, monkeypatch):
    bench, session, built = build_bench(), make_home(build_session), count_trees(monkeypatch)
    bench.handle.load(session.scene)
    bench.runner.draft(session, PLAN)
    bench.handle.load(msgspec.structs.replace(session.scene, episode="another"))

    assert bench.run(session).ended is Ended.COMPLETED
    assert built == ["home", "home"]
