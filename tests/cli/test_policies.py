"""`paos policy`: mistakes of a person are told as such."""

from phyagentos.cli.outcome import ExitCode


def test_a_session_that_is_not_there_is_no_internal_error(paos, run):
    run.begin()
    run.submit("red")

    done = paos("policy", "replay", "rad", "-w", str(run.workspace.root))

    assert done.code == ExitCode.INVALID_INPUT
    assert "rad: UNKNOWN_SESSION: found no such session; expected tidy-7.red" in done.err
    assert "Did you mean 'red'" in done.err


def test_what_is_no_policy_is_not_served(paos, tmp_path):
    done = paos("policy", "serve", "pick_and_place", str(tmp_path / "model.onnx"))

    assert done.code == ExitCode.INVALID_INPUT
    assert "POLICY_MISMATCH" in done.err
