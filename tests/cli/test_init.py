"""`paos init`: a place of one's own, complete and clean from the first moment."""

from pathlib import Path

from phyagentos.cli.outcome import ExitCode

ROOT = Path(__file__).resolve().parents[2]


def test_a_new_place_lints_clean_and_compiles(paos, tmp_path):
    place = tmp_path / "mine"
    assert paos("init", place).code == ExitCode.GOAL_MET
    linted = paos("lint", place)
    assert (linted.code, linted.err) == (ExitCode.GOAL_MET, "")
    assert "4 files checked" in linted.out
    compiled = paos("compile", place / "goal_graphs" / "first.yaml")
    assert compiled.code == ExitCode.GOAL_MET
    assert "show: show_and_place(" in compiled.out


def test_a_new_place_brings_a_graph_a_scene_and_a_skill(paos, tmp_path):
    paos("init", tmp_path / "mine")
    files = {path.relative_to(tmp_path / "mine").as_posix() for path in (tmp_path / "mine").rglob("*.*")}
    assert {
        "README.md",
        "goal_graphs/first.yaml",
        "scenes/desk.yaml",
        "skills/show_and_place/SKILL.md",
        "trees/show_and_place.yaml",
    } <= files


def test_init_never_overwrites(paos, tmp_path):
    (tmp_path / "notes.txt").write_text("mine", encoding="utf-8")
    result = paos("init", tmp_path)
    assert result.code == ExitCode.INVALID_INPUT
    assert "WOULD_OVERWRITE: found a folder that is not empty" in result.err
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_the_next_command_that_init_prints_names_a_file_that_exists(paos, tmp_path):
    place = tmp_path / "mine"
    words = paos("init", place).out.split()
    assert Path(words[-1]).is_file()


def test_the_scaffold_uses_the_skill_of_the_first_example_unchanged(paos, tmp_path):
    paos("init", tmp_path / "mine")
    for name in ("skills/show_and_place/SKILL.md", "trees/show_and_place.yaml"):
        mine = (tmp_path / "mine" / name).read_text(encoding="utf-8")
        assert mine == (ROOT / "examples/projects/01_yaml_skill" / name).read_text(encoding="utf-8")
