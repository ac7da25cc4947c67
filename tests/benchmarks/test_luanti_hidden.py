"""The hidden book of Luanti: what may be tried, and what is known by it."""

import msgspec
import pytest

from benchmarks.luanti import LIBRARY, write_goal
from benchmarks.luanti_parts.hidden import HiddenBook, iter_verified, write_known
from phyagentos.protocol.sessions.knowledge import Fact, render_knowledge
from phyagentos.protocol.sessions.memory_entries import Scope


def test_a_recipe_is_tried_once_an_ingredient_was_held_and_all_are_in_reach():
    book = HiddenBook.read(LIBRARY)
    assert book.choose_trials(set(), set()) == ["group_tree"]
    assert book.choose_trials(set(), {"group_tree"}) == ["group_wood"]
    trials = book.choose_trials({"group_wood"}, {"group_tree", "group_wood"})
    assert trials[0] == "default_stick"
    assert "default_pick_wood" in trials
    assert not {"default_furnace", "default_torch"} & {*trials}, "nothing that they take was held"


def test_known_is_what_a_verdict_verified_and_a_library_has_no_other_recipe(tmp_path):
    scope = Scope(scene="land", skill="craft", target="player")
    facts = [
        Fact(id="one", statement="Made.", scope=msgspec.structs.replace(scope, object="group_wood"), supported=1),
        Fact(id="two", statement="Tried.", scope=msgspec.structs.replace(scope, object="default_stick")),
    ]
    (tmp_path / "KNOWLEDGE.md").write_text(render_knowledge(facts))
    known = {*iter_verified(tmp_path / "KNOWLEDGE.md")}
    assert known == {"group_wood"}

    library = write_known(LIBRARY, known, tmp_path / "known")
    with pytest.raises(ValueError, match="no plan"):
        write_goal(["default_stick"], tmp_path, library)
    assert write_goal(["group_wood"], tmp_path, library).exists()
