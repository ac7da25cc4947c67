"""Where time goes on while a policy infers, its late chunks lead where it said, and never by a jump."""

import numpy as np
import pytest

from phyagentos.runtime.execution.skill_runtime import SkillStatus
from tests.runtime.policies.stand import CLOSED_M, OPEN_M, PERIOD_S, ROWS, Stand


def tell(positions, gripper, *, delta):
    """Rows of a chunk that lets joint 1 pass these positions, of which the first is where it stands, beside home."""
    rows = np.zeros((len(positions) - 1, 8))
    rows[:, 0] = np.diff(positions) if delta else positions[1:]
    rows[:, 7] = gripper
    return rows


@pytest.mark.parametrize("rate_hz", [50.0, 25.0])
@pytest.mark.parametrize("delta", [False, True], ids=["absolute", "delta"])
@pytest.mark.parametrize("delay_s", [0.0, 0.02, 0.06, 0.1])
def test_a_late_chunk_leads_where_the_policy_said_when_it_was_asked(profile, delay_s, delta, rate_hz):
    home = np.array(profile.arm.home_rad)
    along = lambda t: 0.75 * (1.0 - np.cos(1.2 * np.clip(t, 0.0, np.pi / 1.2)))  # noqa: E731

    def infer(request):
        times_s = request.rows_done * PERIOD_S + np.arange(ROWS + 1) / rate_hz
        rows = tell(along(times_s), times_s[1:] < 1.0, delta=delta)
        rows[:, :7] += 0.0 if delta else home
        return rows, bool(times_s[-1] > np.pi / 1.2)

    stand = Stand(profile, infer, delay_s=delay_s, delta=delta, rate_hz=rate_hz)
    assert stand.run() is SkillStatus.SUCCEEDED, stand.runtime.find_failure()
    times_s = PERIOD_S * np.arange(1, len(stand.joint) + 1)
    assert np.array(stand.joint) - home[0] == pytest.approx(
        along(times_s), abs=1e-3
    )  # rows of 25 Hz have lines between
    assert stand.joint[-1] - home[0] == pytest.approx(1.5, abs=1e-4)
    assert np.array(stand.widths)[times_s < 0.95] == pytest.approx(OPEN_M)
    assert np.array(stand.widths)[times_s > 1.0] == pytest.approx(CLOSED_M)


@pytest.mark.parametrize("stood", [True, False], ids=["stood", "moved"])
def test_a_late_chunk_of_changes_goes_on_from_where_the_arm_is(profile, stood):
    way = 0.002  # of one row

    def infer(request):  # changes its mind between the first chunk and the later ones
        moves = bool(request.sequence) if stood else not request.sequence
        return tell(way * moves * np.arange(ROWS + 1), 1.0, delta=True), request.sequence >= 2

    stand = Stand(profile, infer, delay_s=0.1, delta=True)
    assert stand.run() is SkillStatus.SUCCEEDED
    steps = np.diff(stand.joint, prepend=profile.arm.home_rad[0])
    assert np.isclose(steps, way, atol=1e-9).sum() + np.isclose(steps, 0.0, atol=1e-9).sum() == len(steps)
    assert sorted(set(np.round(steps / way).astype(int))) == [0, 1], "no row that is left out comes at once"


def test_a_policy_moves_an_arm_without_a_gripper_by_rows_without_its_column(profile):
    told = profile.model_dump(exclude={"gripper"}) | {"end_effector": "none"}
    bare, home = type(profile).model_validate(told), np.array(profile.arm.home_rad)
    line = np.linspace(home[0], home[0] + 0.02, ROWS + 1)
    stand = Stand(bare, lambda _: (tell(line, 0.0, delta=False)[:, :-1] + [0.0, *home[1:]], True), delay_s=0.0)

    assert stand.run() is SkillStatus.SUCCEEDED
    assert stand.q == pytest.approx([line[-1], *home[1:]], abs=1e-6)
    assert set(stand.widths) == {0.0}
