"""An authored tree is checked as a whole; each finding says file, line, column, what was found and what is possible."""

import pytest

from phyagentos.errors import DefinitionError
from phyagentos.pictures.trees import draw_tree
from phyagentos.protocol.capabilities.library import Library, find_shipped_root
from phyagentos.protocol.capabilities.trees import iter_short_references, read_tree
from phyagentos.runtime.execution.call_check import iter_call_problems
from phyagentos.runtime.execution.tree_check import check_tree, needs_grasp


@pytest.fixture
def check(tmp_path, registry):
    """Check a tree given by its `children`; further trees may lie beside it."""
    (tmp_path / "trees").mkdir()

    def check(children, header="inputs: {object: {type: entity}}", **others):
        body = f"tree: mine\ndescription: A tree.\n{header}\nroot:\n  sequence:\n    children:\n"
        (tmp_path / "trees" / "mine.yaml").write_text(body + "".join(f"      - {child}\n" for child in children))
        for name, text in others.items():
            (tmp_path / "trees" / f"{name}.yaml").write_text(text)
        library = Library((tmp_path, find_shipped_root()))
        return [str(problem) for problem in check_tree("mine", library, registry)]

    return check


def test_a_sound_tree_has_no_problem(check):
    assert check(["locate: {object: $object}", "open_gripper"]) == []


@pytest.mark.parametrize("reference", ["$object", '"${object}"'])
def test_a_reference_of_before_means_the_same_as_one_in_braces(check, tmp_path, reference):
    assert check([f"locate: {{object: {reference}}}"]) == []
    found = [str(each) for each in iter_short_references(read_tree(tmp_path / "trees" / "mine.yaml"))]
    warned = ['mine.yaml:7:18: INVALID_VALUE: found $object; expected "${object}"'] if reference == "$object" else []
    assert [each.rpartition("/")[2].rstrip(".") for each in found] == warned


@pytest.mark.parametrize("declares", [True, False])
def test_a_tree_without_ports_has_those_of_the_skill_of_its_name(check, tmp_path, declares):
    (tmp_path / "skills" / "mine").mkdir(parents=True)
    skill = "skill: mine\ndescription: A skill.\nkind: builtin\ntree: mine\n"
    skill += "parameters: {thing: {type: entity}}\n"
    (tmp_path / "skills" / "mine" / "SKILL.md").write_text(f"---\n{skill}---\n")
    header = "inputs: {object: {type: entity}}" if declares else ""

    assert check(['locate: {object: "${object}"}' if declares else 'locate: {object: "${thing}"}'], header) == []
    assert list(read_tree(tmp_path / "trees" / "mine.yaml").header.inputs) == ["object" if declares else "thing"]


def test_a_changed_copy_of_a_shipped_tree_has_the_ports_of_the_shipped_skill(tmp_path):
    (tmp_path / "trees").mkdir()
    text = (find_shipped_root() / "trees" / "take.yaml").read_text()
    (tmp_path / "trees" / "take.yaml").write_text(text)

    assert "inputs:" not in text
    assert "object" in read_tree(tmp_path / "trees" / "take.yaml").header.inputs


OBJECT = "inputs: {object: {type: entity}}"
LISTS = "inputs: {things: {type: entities}, corners: {type: points}, object: {type: entity}}"


def loop(values, each="$one", child="open_gripper"):
    return f"for_each: {{each: {each}, in: {values}, child: {child}}}"


@pytest.mark.parametrize(
    ("children", "header", "message"),
    [
        (["open_gripper", "locat: {object: $object}"], OBJECT, "mine.yaml:8:9: UNKNOWN_NAME (leaf): found 'locat'"),
        (["locat: {object: $object}"], OBJECT, "Did you mean 'locate'?"),
        (["locate: {object: $object, poze: $pose}"], OBJECT,
         "mine.yaml:7:35: UNKNOWN_NAME (port): found 'poze'; expected object, pose. Did you mean 'pose'?"),
        (["locate"], OBJECT, "mine.yaml:7:9: MISSING_VALUE: found locate without 'object'"),
        (["wait: {seconds: soon}"], OBJECT, "mine.yaml:7:16: INVALID_VALUE: found 'soon'; expected type number"),
        (["locate: {object: $objekt}"], OBJECT,
         "BROKEN_TREE: found '${objekt}', which nothing writes; expected ${object}. Did you mean 'object'?"),
        (["locate: {object: $object, pose: $pose}", "move_linear: {approach: $pose}"], OBJECT,
         "INVALID_VALUE: found '${pose}' of type pose; expected type approach"),
        (["locate: {object: $object, pose: here}"], OBJECT,
         "INVALID_VALUE: found 'here'; expected a key such as '${pose}' to write to"),
        (["subtree: {tree: pik, with: {object: $object}}"], OBJECT,
         "mine.yaml:7:19: UNKNOWN_NAME (tree): found 'pik'; expected carry_level"),
        (["open_gripper"], "outputs: {site: {type: point}}",
         "mine.yaml:3:11: UNKNOWN_NAME (written key): found 'site'"),
        ([loop("$corners", child="{locate: {object: $one}}")], LISTS,
         "mine.yaml:7:63: INVALID_VALUE: found '${one}' of type point; expected type string"),
        ([loop("$corners", each="$object")], LISTS,
         "mine.yaml:7:20: INVALID_VALUE: found '${object}' of type string; expected type point"),
        ([loop("$object")], LISTS,
         "mine.yaml:7:32: INVALID_VALUE: found '${object}' of type string; expected a list: names of entities"),
        ([loop("[red_cube, 3]")], LISTS, "mine.yaml:7:32: INVALID_VALUE: found ('red_cube', 3); expected a list"),
        ([loop("$thing")], LISTS,
         "mine.yaml:7:32: BROKEN_TREE: found '${thing}', which nothing writes; expected ${corners}, ${object}"),
    ],
)  # fmt: skip
def test_a_mistake_is_told_with_its_place_and_what_is_possible(check, children, header, message):
    assert message in check(children, header)[0]


@pytest.mark.parametrize(
    "children",
    [
        ["wait: {seconds: 1}"],
        [loop("$things", child="{locate: {object: $one}}")],
        [loop("[red_cube, cup]", child="{locate: {object: $one}}")],
    ],
    ids=["a whole number is a number", "elements of an input", "elements that are written out"],
)
def test_what_fits_its_type_has_no_problem(check, children):
    assert check(children, LISTS) == []


def test_ports_of_a_subtree_are_checked_like_those_of_a_leaf(check):
    problems = check(["subtree: {tree: pick, with: {objekt: $object}}"])

    ports = "approach, destination, heading, near, object, relation, within"
    assert any(f"mine.yaml:7:38: UNKNOWN_NAME (port): found 'objekt'; expected {ports}" in p for p in problems)
    assert any("MISSING_VALUE: found pick without 'object'" in p for p in problems)


@pytest.mark.parametrize(
    ("child", "message"),
    [
        ("wait: {seconds: .nan}", ":7:16: INVALID_VALUE: found .nan; expected a finite number"),
        ("wait: {seconds: -.inf}", ":7:16: INVALID_VALUE: found -.inf; expected a finite number"),
        ("wait: {seconds: -1}", ":7:16: INVALID_VALUE: found -1; expected a number of at least 0"),
        ("wait: {seconds: yes}", "found true; expected type number. YAML reads yes, no, on and off as true and false"),
        ('wait: {seconds: "60"}', "found '60'; expected type number. Write 60 without quotes"),
        ("wait: {seconds: 060}", "found 060, which YAML 1.1 reads as octal; expected decimal digits. Write 60"),
        ("move_home: {speed: 0}", "found 0; expected a number greater than 0 and of at most 1"),
        ("move_home: {speed: 150}", "found 150; expected a number greater than 0 and of at most 1"),
        ("open_gripper: {width_m: -0.1}", "found -0.1; expected a number of at least 0"),
        ("plan_reach: {to: [.nan, 0, 0]}", "found (nan, 0, 0); expected finite numbers"),
        ("subtree: {tree: outer, with: {slow: 5}}", "found 5; expected a number greater than 0 and of at most 1"),
        ("subtree: {tree: outer, with: {slow: .nan}}", "found .nan; expected a finite number"),
    ],
)
def test_a_number_is_finite_and_in_the_range_of_the_port_that_reads_it(check, child, message):
    head = "description: A tree.\ninputs: {slow: {type: number}}\nroot:\n  "
    outer = f'tree: outer\n{head}subtree: {{tree: inner, with: {{slow: "${{slow}}"}}}}\n'
    inner = f'tree: inner\n{head}move_home: {{speed: "${{slow}}"}}\n'
    found = check([child], "", outer=outer, inner=inner)
    assert len(found) == 1, found
    assert message in found[0]


def test_the_default_of_an_input_is_in_the_range_of_the_port_that_reads_it(check):
    (found,) = check(['move_home: {speed: "${slow}"}'], "inputs: {slow: {type: number, default: 5}}")
    assert "mine.yaml:3:31: INVALID_VALUE: found 5.0; expected a number greater than 0 and of at most 1" in found


@pytest.mark.parametrize("number", ["5e-1", "1.0e1", "0.5", "5"])
def test_a_number_of_a_port_is_read_as_everywhere(check, number):
    assert check([f"wait: {{seconds: {number}}}"]) == []


@pytest.mark.parametrize(
    ("name", "fitting"), [("a/b", "a_b"), ('"two\\nlines"', "two_lines"), ('" x"', "x"), ("5", "5"), ("yes", "True")]
)
@pytest.mark.parametrize("child", ["open_gripper: {{name: {}}}", "sequence: {{name: {}, children: [open_gripper]}}"])
def test_a_name_that_is_no_step_of_a_path_is_refused(check, child, name, fitting):
    (found,) = check([child.format(name)])
    assert "INVALID_VALUE" in found
    assert child.startswith("sequence") or f"expected a name of one line without '/'. Write '{fitting}'." in found


def test_a_tree_that_contains_itself_is_shown_as_the_cycle(check):
    other = "tree: other\ndescription: A tree.\nroot: {subtree: {tree: mine, with: {object: red_cube}}}\n"

    problems = check(["subtree: {tree: other}"], other=other)

    assert any("CYCLE: found mine -> other -> mine" in problem for problem in problems)


def test_a_condition_is_parsed_and_its_keys_are_checked(check):
    problems = check(['condition: "holding(target, ${objekt})"', 'condition: "holdin(target, red_cube)"'])

    assert any("BROKEN_TREE: found '${objekt}', which nothing writes" in problem for problem in problems)
    assert any("mine.yaml:8:9: UNKNOWN_NAME (predicate): found 'holdin'" in problem for problem in problems)


def test_two_children_of_a_reactive_composite_that_take_time_are_refused(check):
    guarded = 'reactive_sequence: {children: [{condition: "visible(${object})"}, %s]}'
    assert check([guarded % "move_home"]) == []

    (problem,) = check([guarded % "move_home, {retry: {attempts: 2, child: close_gripper}}"])
    assert "BROKEN_TREE: found 'retry' and 'move_home', which both take time, in one reactive_sequence" in problem
    assert problem.endswith("Put them into a 'sequence' of their own.")


def test_all_problems_come_at_once(check):
    assert len(check(["locat", "wait: {seconds: soon}", "locate", "retry: {attempts: 0, child: open_gripper}"])) == 4
    assert len(check(["locat", "wait: {seconds: soon}", "locate"])) == 3


@pytest.mark.parametrize(
    ("child", "message"),
    [
        ("retry: {child: open_gripper}", r"mine.yaml:7:9: MISSING_VALUE: found nothing; expected key 'attempts'"),
        ("retry: {attempts: 0, child: open_gripper}", r"mine.yaml:7:17: INVALID_VALUE: found 0"),
        ("timeout: {second: 2, child: open_gripper}", r"UNKNOWN_NAME \(key\): found 'second'.*Did you mean 'seconds'"),
        ("parallel: {policy: some, children: [wait]}", r"INVALID_VALUE: found 'some'; expected 'all' or 'one'"),
        (
            "{locate: {}, wait: {}}",
            r"INVALID_VALUE: found a mapping with keys locate, wait; expected a mapping with one",
        ),
        ("sequence: {children: []}", r"INVALID_VALUE.*at least 1 of them"),
        ("locate: [red_cube]", r"INVALID_VALUE: found \['red_cube'\]; expected a mapping of ports"),
        ('condition: ""', r"INVALID_VALUE"),
        ("repeat: {times: 0, child: open_gripper}", r"mine.yaml:7:18: INVALID_VALUE: found 0"),
        ("cooldown: {seconds: 0, child: open_gripper}", r"mine.yaml:7:20: INVALID_VALUE: found 0"),
        ("for_each: {each: one, in: $all, child: open_gripper}", r"mine.yaml:7:20: INVALID_VALUE: found 'one'"),
        ("for_each: {each: $one, child: open_gripper}", r"MISSING_VALUE: found nothing; expected key 'in'"),
        ("reactive_sequence: {children: []}", r"INVALID_VALUE.*at least 1 of them"),
    ],
)
def test_structural_errors_say_where_and_what_is_possible(tmp_path, child, message):
    path = tmp_path / "mine.yaml"
    path.write_text(f"tree: mine\ndescription: A tree.\n\nroot:\n  sequence:\n    children:\n      - {child}\n")

    with pytest.raises(DefinitionError, match=message):
        read_tree(path)


def test_siblings_of_the_same_leaf_get_different_names(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("tree: mine\ndescription: A tree.\nroot: {sequence: {children: [wait, wait, wait]}}\n")

    assert [child.name for child in read_tree(path).root.children] == ["wait", "wait.2", "wait.3"]


def test_a_number_after_a_name_steps_aside_for_a_sibling_that_is_called_so(tmp_path):
    path = tmp_path / "mine.yaml"
    names = ["x", "x", "x.2", "", "x", "wait.2", ""]
    children = "".join(f"      - wait: {{name: '{name}', seconds: 0.1}}\n" for name in names)
    path.write_text(f"tree: mine\ndescription: A tree.\nroot:\n  sequence:\n    children:\n{children}")
    root = read_tree(path).root
    assert [child.name for child in root.children] == ["x", "x.3", "x.2", "wait", "x.4", "wait.2", "wait.3"]


def test_a_tree_under_another_name_than_its_file_is_refused(tmp_path):
    path = tmp_path / "yours.yaml"
    path.write_text("tree: mine\ndescription: A tree.\nroot: wait\n")

    with pytest.raises(DefinitionError, match=r"INVALID_VALUE: found 'mine'; expected the file's name 'yours'"):
        read_tree(path)


def write_ladder(rungs, times):
    """Text of trees by name, of which each has the next one several times; the last one waits."""
    rung = "tree: t{0}\ndescription: x.\nroot:\n  sequence:\n    children:\n"
    texts = {
        f"t{each}": rung.format(each)
        + "".join(f"      - subtree: {{tree: t{each + 1}, name: n{time}}}\n" for time in range(times))
        for each in range(rungs)
    }
    return texts | {f"t{rungs}": f"tree: t{rungs}\ndescription: x.\nroot:\n  wait: {{seconds: 1.0}}\n"}


@pytest.mark.slow
@pytest.mark.parametrize(("rungs", "times", "found"), [(60, 2, "32765 nodes in 14 levels"), (110, 1, "in 101 levels")])
def test_a_tree_that_grows_without_end_by_its_subtrees_is_refused_at_once(
    check, tmp_path, registry, rungs, times, found
):
    problems = check(["subtree: {tree: t0}"], header="", **write_ladder(rungs, times))

    assert len(problems) == 1, problems
    assert "TOO_LARGE" in problems[0]
    assert found in problems[0]
    library = Library((tmp_path, find_shipped_root()))
    assert not needs_grasp(read_tree(tmp_path / "trees" / "mine.yaml").root, library, registry)
    assert not list(iter_call_problems("mine", library, (), "arm"))
    with pytest.raises(DefinitionError, match="TOO_LARGE"):
        draw_tree(read_tree(tmp_path / "trees" / "mine.yaml"), library)


def test_a_tree_of_many_subtrees_below_the_limit_is_sound(check):
    assert check(["subtree: {tree: t0}"], header="", **write_ladder(10, 2)) == []
