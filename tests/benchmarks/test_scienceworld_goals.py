"""Goals from descriptions of ScienceWorld's tasks, without the environment: forms, skills that name no task, scores."""

import pytest

from benchmarks.scienceworld import KIT, LIBRARY, sum_up
from benchmarks.scienceworld_parts.understand import understand, write_goal

TASKS = (
    "boil", "melt", "freeze", "change-the-state-of-matter-of", "use-thermometer",
    "measure-melting-point-known-substance", "measure-melting-point-unknown-substance", "power-component",
    "power-component-renewable-vs-nonrenewable-energy", "test-conductivity", "test-conductivity-of-unknown-substances",
    "find-living-thing", "find-non-living-thing", "find-plant", "find-animal", "grow-plant", "grow-fruit",
    "chemistry-mix", "chemistry-mix-paint-secondary-color", "chemistry-mix-paint-tertiary-color",
    "lifespan-longest-lived", "lifespan-shortest-lived", "lifespan-longest-lived-then-shortest-lived",
    "identify-life-stages-1", "identify-life-stages-2", "inclined-plane-determine-angle",
    "inclined-plane-friction-named-surfaces", "inclined-plane-friction-unnamed-surfaces",
    "mendelian-genetics-known-plant", "mendelian-genetics-unknown-plant",
)  # fmt: skip
SAID = {
    "find a(n) animal. First, focus on the thing. Then, move it to the red box in the kitchen.": ["attend", "bring"],
    "melt chocolate. First, focus on the substance. Then, take actions that change its state of matter.": [
        "hold", "attend", "change",
    ],
    "turn on the red light bulb by powering it using a renewable power source. First, focus on the red light bulb.": [
        "attend", "power",
    ],
    "use chemistry to create green-blue paint. When you are part-way done, focus on the intermediate paint.": [
        "mix", "attend", "mix", "attend",
    ],
    "focus on the 4 life stages of the turtle, starting from earliest to latest.": ["attend_stages"],
    "determine which of the two inclined planes (C, B) has the shallowest angle. After completing your experiment,": [
        "compare_slopes", "attend_by",
    ],
}  # fmt: skip


@pytest.mark.parametrize(("said", "skills"), SAID.items())
def test_a_description_becomes_sessions_by_its_words(said, skills):
    assert [step.skill for step in understand(f"Your task is to {said}")] == skills


def test_what_no_form_fits_is_refused_and_not_guessed():
    with pytest.raises(ValueError, match="no form fits 'Your task is to juggle"):
        understand("Your task is to juggle three oranges.")


def test_a_threshold_chooses_the_box_and_the_goal_counts_what_was_attended():
    steps = understand(
        "Your task is to measure the temperature of unknown substance B, which is located around the living room. "
        "First, focus on the thermometer. Next, focus on the unknown substance B. If the unknown substance B "
        "temperature is above -5.0 degrees celsius, place it in the red box. If the unknown substance B "
        "temperature is below -5.0 degrees celsius, place it in the green box. "
        "The boxes are located around the bathroom."
    )
    chosen = steps[-1].arguments
    assert (chosen["at_least"], chosen["first"], chosen["second"]) == (-5.0, "red box", "green box")
    goal = write_goal("boxes", "house", steps)
    assert goal["accept"] == ["vital(attended) >= 2 and vital(measured) >= 1 and vital(brought) >= 1"]
    assert goal["sessions"]["step_4"]["with"]["what"] == "unknown_substance_b"


def test_skills_trees_and_tools_name_no_task():
    files = [file for folder in (LIBRARY, KIT) for file in folder.rglob("*") if file.suffix in {".py", ".yaml", ".md"}]
    assert len(files) > 40
    long = [task for task in TASKS if "-" in task]
    found = [(file.name, task) for file in files for task in long if task in file.read_text(encoding="utf-8")]
    assert found == []


def test_the_mean_is_of_tasks_and_a_success_that_the_score_denies_is_counted():
    lines = [
        {"task": "boil", "score": 100, "verdict": "success", "actions": 10},
        {"task": "boil", "score": 50, "verdict": "success", "actions": 20},
        {"task": "melt", "score": 25, "verdict": "failure", "actions": 30},
    ]
    figures = sum_up(lines)
    assert (figures["score_mean"], figures["score_boil"], figures["tasks"]) == (50.0, 75.0, 2)
    assert figures["false_success_share"] == pytest.approx(1 / 3, abs=1e-3)
