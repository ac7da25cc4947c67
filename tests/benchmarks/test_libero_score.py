"""An episode of LIBERO is scored at its end, whatever the order in which its sessions are reported."""

from types import SimpleNamespace

from benchmarks.libero import compute_figures, is_final, score


def make_session(name):
    return SimpleNamespace(
        id=name, sim_time_s=10.0, node=name, verdict="success", state="done", cause="", code="", leaf=""
    )


def test_the_last_line_of_the_scorer_counts_and_not_that_of_the_session_reported_last():
    """A repeated first node came before the second one, and its line was taken: a false success of ours."""
    report = SimpleNamespace(
        sessions=[make_session(name) for name in ("a", "b", "a.r1")],
        verdict="success",
        reason="",
        replans=1,
        first_attempt_success={"a": False, "b": True},
    )
    line = {"success": False, "reached": False}
    lines = {"a": line | {"steps": 1}, "a.r1": line | {"steps": 2}, "b": {"success": True, "reached": True, "steps": 3}}
    server = SimpleNamespace(read_outcomes=lambda: lines | {"of another episode": line | {"steps": 9}})

    record = score({"suite": "s"}, report, server)

    assert is_final(record)
    assert (record["steps"], record["reached"], record["is_first"]) == (3, True, False)
    assert compute_figures([record])["false_success_rate"] == 0.0
