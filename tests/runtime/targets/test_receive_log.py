"""The receive log: nothing that was accepted is missing from it, whatever the disk does."""

import json
import resource
from contextlib import contextmanager

import pytest

from phyagentos.runtime.targets import wire
from phyagentos.runtime.targets.receive_log import ReceiveLog, Reception
from phyagentos.testing import ManualClock


@contextmanager
def full_disk():
    """No file of this process grows any more."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def read(path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def note(log, sequence) -> None:
    log.stamp()
    log.note(Reception(time_s=0.5, kind="Command", session="s", sequence=sequence))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "receive-t.jsonl"


def test_a_line_is_with_the_system_at_once_and_carries_the_time_of_arrival(path):
    log, clock = ReceiveLog(path, ManualClock(1.5)), ManualClock(1.5)
    note(log, 1)

    assert [line["kind"] for line in read(path)] == ["process_start", "Command"]
    assert {line["at"] for line in read(path)} == {clock.wall_iso()}
    log.close()


def test_lines_that_found_the_disk_full_are_written_when_there_is_room(path):
    log = ReceiveLog(path, ManualClock())
    with full_disk():
        note(log, 1)
        note(log, 2)
        assert log.is_behind
        assert len(read(path)) == 1

    assert not log.is_behind
    assert [line.get("sequence") for line in read(path)] == [None, 1, 2]
    log.close()


def test_half_a_line_of_a_dead_process_is_ended_and_kept(path):
    path.write_bytes(b'{"time_s":0.1,"ki')
    ReceiveLog(path, ManualClock()).close()

    lines = path.read_text().splitlines()
    assert lines[0] == '{"time_s":0.1,"ki'
    assert json.loads(lines[1])["kind"] == "process_start"


@pytest.mark.sim
def test_a_target_that_cannot_write_its_log_accepts_no_command_until_it_can(make_rig, path):
    rig = make_rig(log=path)
    rig.load()
    rig.begin()
    command = rig.make_command(rig.observe().target.q_rad)
    with full_disk():
        first, second = rig.send(command), rig.send(rig.make_command(rig.observe().target.q_rad))
        begun = rig.world.handle(wire.Begin(session="other", epoch=1))
    third = rig.send(rig.make_command(rig.driver.controller.q_rad))

    assert isinstance(first, wire.Step)
    assert [second.code, begun.code] == ["WRITE_FAILED", "WRITE_FAILED"]
    assert isinstance(third, wire.Step)
    commands = [line for line in read(path) if line["kind"] == "Command"]
    assert [line.get("accepted", True) for line in commands] == [True, False, True]
