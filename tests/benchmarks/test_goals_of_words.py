"""A goal of which nothing is known but its words: which objects they tell, and that the rest is said, not guessed."""

import pytest
import yaml

from benchmarks.libero_parts.foreign_scenes import Seen, write_scene
from benchmarks.libero_parts.words import describe_names, generate_from_words
from phyagentos.agent.goals.catalogue import Catalogue
from phyagentos.agent.goals.graph import read_goal_graph
from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.world.scenes import SceneSpec

GOAL = "(define (:goal (And (On {} {}))))"


def test_a_name_tells_its_colour_and_its_form():
    assert describe_names(["old_black_pot_1", "red_box_2", "can_3"]) == {
        "old_black_pot_1": "the black thing",
        "red_box_2": "the red box",
        "can_3": "the can",
    }


def test_every_name_without_a_word_that_can_be_seen_is_told():
    with pytest.raises(DefinitionError) as error:
        generate_from_words("g", "", "s", GOAL.format("saucer_1", "shelf_1"), "arm")
    assert [(each.label, each.found) for each in error.value.problems] == [
        ("UNKNOWN_NAME (word)", "'saucer_1'"),
        ("UNKNOWN_NAME (word)", "'shelf_1'"),
    ]


def test_no_word_tells_of_a_joint():
    with pytest.raises(DefinitionError, match=r"UNKNOWN_NAME \(object\)"):
        generate_from_words("g", "", "s", "(define (:goal (And (Close white_box_1))))", "arm")


def test_what_the_words_tell_compiles_over_a_scene_in_which_nothing_is_known(tmp_path):
    for folder in ("scenes", "goal_graphs"):
        (tmp_path / folder).mkdir()
    scene = write_scene("empty", "", [], {}, Seen())
    assert SceneSpec.model_validate(yaml.safe_load(scene)).bodies == {}
    (tmp_path / "scenes" / "empty.yaml").write_text(scene)
    path = tmp_path / "goal_graphs" / "g.yaml"
    graph = generate_from_words("g", "", "empty", GOAL.format("red_can_1", "white_box_1"), "panda")
    path.write_text(yaml.safe_dump(graph))

    compiled = read_goal_graph(path, Catalogue.read(Library((tmp_path, find_shipped_root()))))

    assert compiled.spec.described == {"red_can_1": "the red can", "white_box_1": "the white box"}
    assert compiled.spec.accept == ("on(red_can_1, white_box_1)", "centred(red_can_1, white_box_1, 0.03)")
