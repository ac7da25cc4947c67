"""`paos policy`: mistakes of a person are told as such."""

from tests.command_line import assert_refused


def test_a_session_that_is_not_there_is_no_internal_error(paos, run):
    run.begin()
    run.submit("red")

    assert_refused(
        paos("policy", "replay", "rad", "-w", str(run.workspace.root)),
        "rad: UNKNOWN_NAME (session): found no such session; expected tidy-7.red",
        "Did you mean 'red'",
    )


def test_what_is_no_policy_is_not_served(paos, tmp_path):
    assert_refused(paos("policy", "serve", "pick_and_place", str(tmp_path / "model.onnx")), "POLICY_MISMATCH")
