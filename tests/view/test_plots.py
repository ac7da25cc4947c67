"""Plots of a trajectory: what is drawn, and where limits stand."""

import numpy as np
import pytest

from phyagentos.protocol.capabilities.library import find_shipped_root
from phyagentos.protocol.settings.safety import read_safety
from phyagentos.view.plots import POINTS, draw_plots, thin


@pytest.fixture(scope="module")
def limits():
    return read_safety(find_shipped_root() / "protocol" / "safety.yaml").targets["panda"]


def make_course(n=1000, **changed):
    q = np.zeros((n, 7))
    q[:, 3], q[:, 5] = -1.5, 1.5  # within the range of an arm that is bent
    lag = np.zeros((n, 7))
    lag[n // 2, 2] = 0.2
    width = np.full(n, 0.04)
    course = {"time_s": np.linspace(1.0, 9.0, n), "q_measured": q, "q_commanded": q + lag, "qd_measured": q * 0}
    return course | {"gripper_measured_m": width, "gripper_commanded_m": width} | changed


def test_a_peak_of_one_sample_is_drawn_beside_the_limit_of_the_guard(limits):
    plots = {plot.title: plot for plot in draw_plots(make_course(), limits)}
    error = plots["Tracking error"]
    heights = [float(point.partition(",")[2]) for point in error.curves[0].split()]
    assert heights.count(min(heights)) == 1
    assert len(heights) <= 2 * POINTS
    ((limit, text),) = error.limits
    assert (limit < min(heights), text) == (True, "limit 250.0 mrad")
    assert error.words == "0.0 mrad to 200.0 mrad"
    assert error.edges == ("265.0 mrad", "-15.0 mrad"), "so that a page can say what a height is"
    assert [text for _, text in plots["Gripper"].limits] == ["least 0 mm", "limit 80 mm"]
    assert len(plots["Joint positions, of their range"].curves) == 7


def test_a_limit_far_above_all_values_is_named_and_leaves_them_their_room(limits):
    course = make_course()
    course["q_commanded"] = course["q_measured"] + np.linspace(0.0, 1e-3, 1000)[:, None]
    error = next(plot for plot in draw_plots(course, limits) if plot.title == "Tracking error")
    assert (error.limits, error.words) == ((), "0.0 mrad to 1.0 mrad, limit 250.0 mrad")


@pytest.mark.parametrize("broken", [{"time_s": np.zeros(3)}, {"qd_measured": np.full((1000, 7), np.nan)}])
def test_arrays_that_do_not_fit_together_are_refused(limits, broken):
    with pytest.raises(ValueError, match=r"not one for each moment|broadcast"):
        draw_plots(make_course(**broken), limits)


def test_thinning_leaves_the_ends_and_the_extremes():
    values = np.sin(np.arange(10_000.0))
    values[1234], values[4321] = 5.0, -5.0
    some = thin(values)
    assert {0, 1234, 4321, 9999} <= set(some.tolist())
    assert len(some) <= POINTS + 2
