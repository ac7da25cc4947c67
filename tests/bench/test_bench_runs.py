"""`paos bench` as a person uses it: settings act, a killed run goes on, passes learn, figures lead to evidence."""

import json
import signal
import socket
import subprocess
import sys
import time
import zipfile

import pytest
import yaml

from phyagentos.protocol.workspace.process_lock import WATCHDOG_LOCK, is_held
from tests.bench.suite_of_counter import (
    SUITE,
    add_policy,
    call,
    get_environment,
    make_command,
    make_project,
    read_episodes,
)
from tests.command_line import assert_refused

pytestmark = pytest.mark.journey

ACTING = {
    "plain": {},
    "low": {"set": {"height_m": 0.005}},
    "strict": {"files": {"runtime_contract.yaml": {"verification.criteria": ["metric(ticks) <= 0"]}}},
    "realtime": {"world_mode": "realtime"},
    "once": {"repair": "benchmarks.recovery_parts.baselines:NoRetry"},
}
MODES = {  # of one step of three, what is said of the goal, and how its session ended
    "off": ("unverified", "unverified"),
    "enforce": ("failure", "failed"),
}


def test_each_setting_acts_on_the_ordinary_path_and_every_figure_leads_to_its_bundles(tmp_path):
    folder = make_project(
        tmp_path / "p",
        settings=ACTING,
        verification=["recovery"],
        seeds=[3],
        asked=[{"figure": "final", "where": {"setting": "plain", "verification": "recovery"}, "at_least": 1.0}],
    )
    call(folder, "run", "suite.yaml", "-r", "r", "-j", 2)
    check_settings(read_episodes(folder / "r"))
    check_report(folder / "r")


def check_settings(records):
    found = {id: (each["verdict"], len(each["sessions"]), each["is_met"]) for id, each in records.items()}

    assert found == {
        "lift.plain.recovery.3": ("success", 3, True),
        "lift.low.recovery.3": ("success", 1, False),  # lower than the scorer asks: a false success
        "lift.strict.recovery.3": ("failure", 3, True),
        "lift.realtime.recovery.3": ("failure", 1, False),  # refused: a counter keeps no real time
        "lift.once.recovery.3": ("failure", 1, False),
    }
    assert records["lift.realtime.recovery.3"]["taxon"] == "adapter"
    assert {each["taxon"] for id, each in records.items() if id.startswith(("lift.low.r", "lift.strict.r"))} == {
        "verifier"
    }


def check_report(acted):
    report = json.loads((acted / "report.json").read_text())
    row = next(row for row in report["rows"] if row["axes"]["setting"] == "plain")
    (episode,) = [each for each in report["episodes"] if each["id"] in row["episodes"]]

    assert row["final"] == {
        "successes": 1,
        "trials": 1,
        "share": 1.0,
        "wilson_95": pytest.approx([0.2065, 1.0], abs=1e-4),
    }
    assert [session["id"] for session in episode["sessions"]] == ["lift-3.high", "lift-3.high.r1", "lift-3.high.r2"]
    assert all((acted / session["bundle"] / "execution.json").is_file() for session in episode["sessions"])
    held = {row["part"]: row["hashes"]["lift"] for row in report["held"]}
    assert [*held] == ["planner", "memory", "verifier", "settings", "targets", "adapters", "skills"]
    assert [part for part, hashes in held.items() if len(hashes) > 1] == ["settings"], "one setting changes criteria"
    page = (acted / "report.html").read_text()
    assert page.count("<svg ") == 3
    assert all(session["bundle"] in page for session in episode["sessions"])
    assert "http" not in page, "no outside request"
    assert "src=" not in page or "src='data:" in page
    assert "lift-3.high.r2" in (acted / "report.md").read_text() or "lift.plain.recovery.3" in page


def test_a_run_that_is_killed_goes_on_without_repeating_or_losing_an_episode(tmp_path, paos, monkeypatch):
    folder = make_project(tmp_path / "p", seeds=[0], verification=list(MODES))
    run = folder / "r"
    process = subprocess.Popen(
        make_command("run", "suite.yaml", "-r", "r", "-j", 1), cwd=folder, env=get_environment(), start_new_session=True
    )
    deadline_s = time.monotonic() + 120.0  # noqa: TID251
    is_busy = False
    while not 2 <= len(list(run.glob("episodes/*/workspace/workspace.yaml"))) == len(read_lines(run)) + 1:
        assert process.poll() is None
        if not is_busy and (run / "episodes").exists():
            process.send_signal(signal.SIGSTOP)  # its first episode goes on, and no further one begins meanwhile
            is_busy = "BUSY" in call(folder, "resume", "r", code=4).stderr
            process.send_signal(signal.SIGCONT)
        assert time.monotonic() < deadline_s, "no second episode began"  # noqa: TID251
        time.sleep(0.01)  # noqa: TID251
    process.kill()
    process.wait()
    with (run / "episodes.jsonl").open("ab") as log:
        log.write(b'{"id":"lift.1","task":"li')  # what a cut leaves of a line
    before = read_lines(run)[:-1]
    told = {json.loads(line)["folder"] for line in before}
    (half_done,) = [path for path in run.glob("episodes/*/workspace") if f"episodes/{path.parent.name}" not in told]

    call(folder, "resume", "r")

    lines = read_lines(run)
    assert is_busy
    assert lines[: len(before)] == before
    assert sorted(json.loads(line)["id"] for line in lines) == sorted(f"lift.{mode}.0" for mode in MODES)
    repeated = next(record for record in read_episodes(run).values() if f"{record['id']}-1" == half_done.parent.name)
    assert repeated["folder"] == f"episodes/{repeated['id']}-2", (
        "a half-done episode begins anew in a folder of its own"
    )
    assert not is_held(half_done / WATCHDOG_LOCK), "no process of the killed run is left"
    done = {record["verification"]: record for record in read_episodes(run).values()}
    assert {mode: (each["verdict"], each["sessions"][0]["state"]) for mode, each in done.items()} == MODES
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)
    assert paos("bench", "resume", "r").code == 0
    assert read_lines(run) == lines
    graph = folder / "goal_graphs" / "lift.yaml"
    graph.write_text(graph.read_text().replace("Three", "Four"))
    assert "lift.yaml: CHANGED" in paos("bench", "resume", "r").err


def read_lines(run):
    path = run / "episodes.jsonl"
    return path.read_bytes().splitlines() if path.exists() else []


def test_passes_that_adapt_leave_memory_to_frozen_ones(tmp_path):
    passes = {
        "learn": {"memory": "adapting", "seeds": [0]},
        "after": {"memory": "frozen"},
        "emptied": {"memory": "emptied"},
    }
    folder = make_project(tmp_path / "p", passes=passes, seeds=[5])
    call(folder, "run", "suite.yaml", "-r", "r", "-j", 2)
    records = read_episodes(folder / "r")
    first, after, emptied = (records[id] for id in ("learn.lift.0", "after.lift.5", "emptied.lift.5"))

    sizes = [measure_experience(folder / "r" / each["folder"]) for each in (emptied, first, after)]
    assert sizes[0] == 0 < sizes[1] == sizes[2], "an adapting one learns, frozen ones read"
    assert after["memory_before"] == after["memory_after"] == first["memory_after"]
    assert emptied["memory_before"] == first["memory_before"]


def measure_experience(episode):
    return sum(path.stat().st_size for path in (episode / "memory").rglob("*.md"))


def test_a_policy_is_served_while_its_episodes_run_and_no_longer(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    folder = make_project(tmp_path / "p", seeds=[1])
    ready = add_policy(folder, port)
    command = [sys.executable, "lifter.py", "0.06"]
    suite = {**SUITE, "seeds": [1], "policies": {"lifter": {"serve": command, "ready": ready}}}
    (folder / "suite.yaml").write_text(yaml.safe_dump(suite))
    call(folder, "run", "suite.yaml", "-r", "r")
    (record,) = read_episodes(folder / "r").values()

    assert (record["verdict"], record["policy"], record["is_met"]) == ("success", "lifter", True)
    assert [session["skill"] for session in record["sessions"]] == ["ride"]
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port), 1.0)


@pytest.mark.sim
def test_what_is_asked_of_a_simulated_world_acts_too(tmp_path):
    task = {
        "graph": "tidy_table",
        "score": {"red": {"in_tray": ["red_cube", "red_tray"]}},
        "pictures": False,
        "set": {"defaults.max_replans": 0},
    }
    settings = {"slip": {"faults": "faults.yaml", "sense": "truth"}, "blind": {"sense": "perceived", "prior": "none"}}
    folder = tmp_path / "p"
    folder.mkdir()
    slip = {"version": 1, "faults": [{"kind": "slip", "object": "red_cube"}]}
    (folder / "faults.yaml").write_text(yaml.safe_dump(slip))
    suite = {**SUITE, "tasks": {"tidy": task}, "settings": settings, "seeds": [7], "scorer": "simulator"}
    (folder / "suite.yaml").write_text(yaml.safe_dump(suite))
    call(folder, "run", "suite.yaml", "-r", "r", "-j", 2, code=0)
    blind, record = (read_episodes(folder / "r")[f"tidy.{setting}.7"] for setting in ("blind", "slip"))
    bundle = folder / "r" / record["sessions"][0]["bundle"]

    assert (record["verdict"], record["is_met"], record["taxon"]) == ("failure", False, "execution")
    assert json.loads((bundle / "faults.json").read_text())
    assert not (bundle / "before.png").exists()
    assert not list(bundle.glob("look-*"))
    assert (blind["verdict"], blind["is_met"], blind["taxon"]) == ("failure", False, "perception")
    assert not any(session.get("ticks") for session in blind["sessions"]), "nothing has a name that the goal knows"


def write_wheel(folder):
    """A package of one module, ready to install without any other."""
    path = folder / "tiny-1.2-py3-none-any.whl"
    files = {
        "tiny.py": "",
        "tiny-1.2.dist-info/METADATA": "Metadata-Version: 2.1\nName: tiny\nVersion: 1.2\n",
        "tiny-1.2.dist-info/WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    with zipfile.ZipFile(path, "w") as wheel:
        for name, text in files.items():
            wheel.writestr(name, text)
        wheel.writestr("tiny-1.2.dist-info/RECORD", "".join(f"{name},,\n" for name in files))
    return path


def test_an_environment_is_made_from_its_declaration_once_it_is_asked_for(tmp_path, paos, monkeypatch):
    monkeypatch.setenv("PHYAGENTOS_ENVIRONMENTS", str(tmp_path / "environments"))
    monkeypatch.setenv("PIP_NO_INDEX", "1")  # nothing comes from elsewhere
    monkeypatch.chdir(tmp_path)
    declared = {"packages": [f"tiny @ {write_wheel(tmp_path).as_uri()}"], "imports": ["tiny"], "about": "Of a test."}
    suite = {**SUITE, "environments": {"other": declared}}
    (tmp_path / "suite.yaml").write_text(yaml.safe_dump(suite))
    python = tmp_path / "environments" / "other" / "bin" / "python"

    assert_refused(paos("bench", "setup", "suite.yaml"), "would run:")
    assert not python.exists(), "nothing is installed unasked"
    made = paos("bench", "setup", "suite.yaml", "--yes")
    assert (made.code, made.out) == (0, f"environment 'other': {python}\n"), made.err
    assert subprocess.run([python, "-c", "import tiny"], check=False).returncode == 0
    assert paos("bench", "setup", "suite.yaml").out == "environment 'other' is whole\n"
