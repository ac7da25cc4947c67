"""A predicate and a leaf in a project's own folder: both planes run them, of this project, without a package."""

import json

import pytest

GRAPH = """goal: nearest
objective: Put the nearest cube into the green tray, which is within reach.
scene: tabletop/cubes_and_trays
targets: {arm: panda}
sessions:
  first:
    skill: take_nearest
    target: arm
    with: {kind: cube, destination: green_tray}
    accept: ["count(inside(*, green_tray)) >= 1", "not far_out(green_tray)"]
"""


@pytest.mark.journey
def test_a_goal_is_met_by_a_leaf_and_judged_by_a_predicate_of_the_project(paos, tmp_path, monkeypatch):
    place = tmp_path / "mine"
    assert paos("init", place, "--with", "leaf", "--with", "predicate").code == 0
    (place / "goal_graphs" / "nearest.yaml").write_text(GRAPH)
    monkeypatch.chdir(place)

    done = paos("run", "goal_graphs/nearest.yaml", "--no-pictures", "--json")

    assert done.code == 0, done.err
    (session,) = json.loads(done.out)["goal"]["sessions"]
    assert (session["skill"], session["state"]) == ("take_nearest", "succeeded")
