"""Many runs from Python, on the loop of the benchmarks; here each run is a record and two pictures."""

import asyncio
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

import phyagentos as library
from phyagentos.bench import many
from phyagentos.bench.engines import open_engine
from phyagentos.errors import DefinitionError

ROOT = Path(__file__).resolve().parents[2]
EVIL = '<script>alert("x")</script>'


def run_tidy(seeds=range(4), **options):
    return library.run_many("tidy_table", seeds=seeds, **options)


def test_runs_come_back_with_their_rate_and_their_failures_as_pictures(carried):
    runs = run_tidy(
        faults="slip", sense="truth", settings={"safety.yaml": {}}, speed=0.5, overrides={"targets.arm": "panda"}
    )

    assert str(runs) == "runs/tidy_table-1: 3/4 = 75.0 % [30.1, 95.4]"
    assert repr(runs) == f"<{runs}>", "a prompt shows what print() does"
    assert repr(runs.failures[0]).startswith("<seed 2: failure, ")
    assert (runs.rate.value, runs.pending, [each.seed for each in runs.failures]) == (0.75, 0, [2])
    assert [path.name for path in runs.failures[0].pictures] == ["before.png", "after.png"]
    assert runs.failures._repr_html_().count('src="data:image/jpeg;base64,') == 2
    assert {job.order.variant["sense"] for job in carried.jobs} == {"truth"}
    assert carried.jobs[0].order.variant["files"]["runtime_contract.yaml"] == {"speed": 0.5}
    assert carried.jobs[0].order.variant["set"] == {"targets.arm": "panda"}


def test_an_override_is_the_value_that_its_text_is_in_yaml(carried, tmp_path):
    written = (ROOT / "goal_graphs" / "tidy_table.yaml").read_text()
    written += "  - near(red_cube, red_tray, ${far_m})\n"
    parameters = "parameters: {far_m: {type: number, description: How far., default: 0.3}}\n"
    graph = tmp_path / "far.yaml"
    graph.write_text(written.replace("goal: tidy_table", f"goal: far\n{parameters}".rstrip()))
    library.run_many(graph, seeds=[0], overrides={"far_m": 0.25, "targets.arm": "panda"})
    assert carried.jobs[0].order.variant["set"] == {"far_m": 0.25, "targets.arm": "panda"}


def test_one_number_in_place_of_seeds_is_refused_with_what_was_meant(carried):
    with pytest.raises(DefinitionError, match=r"seeds: INVALID_VALUE.*range\(3\)"):
        run_tidy(seeds=3)


def test_nothing_that_a_run_says_becomes_markup(carried):
    runs = run_tidy()
    for shown in (runs, runs.failures):
        assert EVIL not in shown._repr_html_()
        assert "&lt;script&gt;" in shown._repr_html_()


def test_runs_are_read_again_from_their_folder_and_no_folder_is_written_twice(carried):
    runs = run_tidy(folder="kept")

    assert library.open_runs("kept").rows() == runs.rows()
    for call in (lambda: run_tidy(folder="kept"), lambda: library.open_runs("gone")):
        with pytest.raises(DefinitionError, match=r"WOULD_OVERWRITE|NOT_A_WORKSPACE"):
            call()


def test_two_settings_are_compared_by_pairs_of_one_seed(carried):
    found = library.compare(run_tidy(), run_tidy(sense="truth", seeds=range(1, 5), verify="audit"))

    assert (found.a.trials, found.lost, found.gained) == (3, (), ())
    assert "only in A: tidy_table 0" in str(found)
    assert found._repr_html_().startswith("<pre>A 2/3")


@pytest.mark.parametrize("frames", [("polars", "pandas"), ("pandas",), ()])
def test_rows_become_a_frame_of_what_is_installed(carried, monkeypatch, frames):
    for name in many.FRAMES:
        module = SimpleNamespace(DataFrame=lambda rows, name=name: (name, rows)) if name in frames else None
        monkeypatch.setitem(sys.modules, name, module)
    runs = run_tidy()
    if not frames:
        with pytest.raises(ImportError, match="pip install polars"):
            runs.to_frame()
        return
    name, rows = runs.to_frame()
    assert (name, rows) == (frames[0], runs.rows())
    assert [(row["seed"], row["success"], row["verdict"]) for row in rows[1:3]] == [
        (1, True, "success"),
        (2, False, "failure"),
    ]


def test_an_interrupt_leaves_what_has_ended_and_says_how_to_go_on(carried):
    carried.interrupted_by = 2
    with pytest.raises(KeyboardInterrupt) as interrupted:
        run_tidy()
    (note,) = interrupted.value.__notes__
    assert note.endswith("2 left. The rest: paos.open_runs('runs/tidy_table-1').resume()")
    carried.interrupted_by = None
    assert [each.seed for each in library.open_runs("runs/tidy_table-1").resume().episodes] == [0, 1, 2, 3]
    assert [job.order.seed for job in carried.jobs] == [0, 1, 2, 2, 3]


def test_a_cancelled_task_leaves_what_has_ended(carried):
    carried.endless = 1

    async def cancel():
        task = asyncio.create_task(library.run_many_async("tidy_table", seeds=range(3), folder="kept"))
        while not carried.waits.is_set():
            await asyncio.sleep(0.01)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(cancel())
    assert (len(library.open_runs("kept").episodes), library.open_runs("kept").pending) == (1, 2)


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"seeds": []}, "seeds: INVALID_VALUE"),
        ({"seeds": [-1]}, "seeds: INVALID_VALUE"),
        ({"sense": "truht"}, "UNKNOWN_NAME"),
        ({"speed": 1.5}, "--speed: INVALID_VALUE"),
        ({"overrides": {"cube": "red"}}, "UNKNOWN_NAME"),
        ({"settings": {"runtime.yaml": {"a": 1}}}, "run_many: UNKNOWN_NAME .* Did you mean 'runtime_contract.yaml'"),
    ],
)
def test_runs_that_cannot_begin_are_refused_before_a_folder_is_made(carried, tmp_path, options, code):
    with pytest.raises(DefinitionError, match=code):
        run_tidy(**options)
    assert list(tmp_path.iterdir()) == []


def test_a_notebook_follows_the_runs_as_they_end(carried, monkeypatch):
    shown = []
    handle = SimpleNamespace(update=lambda data, raw: shown.append(data["text/plain"]))
    interactive, display = ModuleType("IPython"), ModuleType("IPython.display")
    interactive.get_ipython = lambda: SimpleNamespace(kernel=1)
    display.display = lambda *_, **__: handle
    monkeypatch.setitem(sys.modules, "IPython", interactive)
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    run_tidy(seeds=range(2))
    run_tidy(seeds=range(2), progress=False)
    assert shown == [
        "runs/tidy_table-1: -, 2 left",
        "runs/tidy_table-1: 1/1 = 100.0 % [20.7, 100.0], 1 left",
        "runs/tidy_table-1: 2/2 = 100.0 % [34.2, 100.0]",
    ]


@pytest.mark.journey
def test_seeds_are_run_on_physics_and_judged_by_their_verdicts(tmp_path, monkeypatch):
    assert many.open_engine is open_engine
    monkeypatch.chdir(tmp_path)
    runs = library.run_many("press_button", seeds=[0, 1], sense="truth", pictures=False)
    assert ([each.verdict for each in runs.episodes], runs.rate.value) == (["success", "success"], 1.0)
    (session,) = library.open_workspace(runs.episodes[0].workspace)
    assert session.verdict == "success"
