"""Stop requests whose words no document can hold: the stop counts, and nobody who supervises ends over a file."""

import json
import os
from pathlib import Path

import pytest

from phyagentos.protocol.capabilities.library import Library
from phyagentos.protocol.documents.document import read_document
from phyagentos.protocol.sessions.estop import Latch, latch, read_latch, reset
from phyagentos.protocol.sessions.runtime_signal import RUNTIME_SIGNAL, RequestState
from phyagentos.protocol.sessions.stop_signals import Signal, SignalReader, drop_signal, take_signals
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.store.runtime_signal import RuntimeSignal
from phyagentos.testing import ManualClock

ODD = ["arm too close\x7f", "one \x9b, two \ufffe", "nothing \x00\x1b[0m", "half of \ud83d", "Gef\udce4\udcdf"]
NAMES = [b"n" * 255, b"n" * 250 + b".yaml", b"\xff\xfe.yaml", b"two\nlines"]


def lay(folder, name, data):
    (folder / "new").mkdir(parents=True, exist_ok=True)
    path = os.fsencode(folder / "new") + b"/" + name
    Path(os.fsdecode(path)).write_bytes(data)
    os.utime(path, (1, 1))


def list_names(folder):
    return [os.fsencode(path.name) for path in folder.iterdir()]


@pytest.mark.parametrize("reason", ODD)
def test_a_request_is_taken_whatever_its_reason_holds(tmp_path, clock, reason):
    drop_signal(tmp_path, Signal(kind="cancel", reason=reason), clock)

    heard = SignalReader(tmp_path).read_new()
    assert take_signals(tmp_path) == heard
    assert [signal.kind for signal in heard] == ["cancel"]
    assert heard[0].reason.startswith(reason[:3])


@pytest.mark.parametrize("reason", ODD)
def test_a_stop_latches_and_is_reset_whatever_its_reason_holds(tmp_path, reason):
    latch(tmp_path, Latch(by="ann", reason=reason))
    assert read_latch(tmp_path).by == "ann"
    assert read_latch(tmp_path).reason.startswith(reason[:3])

    reset(tmp_path, reason, ManualClock())
    assert read_latch(tmp_path) is None


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (json.dumps({"kind": "estop", "reason": "fire 🔥"}).encode(), "fire 🔥"),
        (rb'{kind: estop, reason: "fire \ud83d\udd25"}', "fire ��"),
        (rb'{"kind": "estop", "reason": "fire \ud83d"}', "fire �"),
        (rb'{"kind": "estop", "reason": "close\u009b"}', "close�"),
        (b'{"kind": "estop", "reason": "close\x7f"}', "close�"),
        (b"kind: estop\nreason: close\x00\x1b\n", "close��"),
        ('{"kind": "estop", "reason": "Gefäß"}'.encode("latin-1"), "Gefäß"),
        ("kind: estop\nreason: Gefäß\n".encode("utf-16"), "Gefäß"),
        ("kind: estop\nreason: Gefäß\n".encode("utf-8-sig"), "Gefäß"),
    ],
)
def test_a_stop_of_any_tool_counts_and_can_be_kept(tmp_path, data, reason):
    lay(tmp_path, b"by-hand", data)

    heard = SignalReader(tmp_path).read_new()
    assert take_signals(tmp_path) == heard == [Signal(kind="estop", reason=reason)]
    latch(tmp_path, Latch(reason=heard[0].reason))
    assert read_latch(tmp_path).reason == reason


@pytest.mark.parametrize(
    "data",
    [
        b"[" * 3000,
        b"[" * 100_000 + b"]" * 100_000,
        b'{"kind":' * 100_000,
        b"kind: [estop\x7f",
        b"\xff\xfe\x00\xd8",
        b"\xff",
    ],
)
@pytest.mark.parametrize("name", [b"plain", *NAMES])
def test_a_file_that_nobody_can_read_is_refused_with_the_reason_and_stops_nobody(tmp_path, clock, name, data):
    lay(tmp_path, name, data)
    lay(tmp_path, b"z", b"kind: estop")

    assert [signal.kind for signal in SignalReader(tmp_path).read_new()] == ["estop"]
    assert [signal.kind for signal in take_signals(tmp_path)] == ["estop"]
    kept, *reasons = sorted(list_names(tmp_path / "rejected"), key=lambda each: b".reason" in each)
    assert kept == name
    assert [each[:200] for each in reasons] == [(name + b".reason.txt")[:200]]
    assert not list((tmp_path / "new").iterdir())


def test_two_long_names_keep_a_reason_each(tmp_path):
    for name in (b"n" * 254 + b"a", b"n" * 254 + b"b", b"n" * 254 + b"a"):
        lay(tmp_path, name, b"kind: stop")
        take_signals(tmp_path)

    names = list_names(tmp_path / "rejected")
    assert len([name for name in names if name.endswith(b".reason.txt")]) == 2
    assert len(names) == 5


def test_the_document_of_the_runtime_shows_every_request(tmp_path):
    workspace = Workspace.create(tmp_path / "w", Library(()))
    for name in NAMES[1:]:
        lay(workspace.signals.parent, name, json.dumps({"kind": "estop", "reason": "fire 🔥\x7f"}).encode())
    lay(workspace.signals.parent, b"deep", b"[" * 3000)
    RuntimeSignal(workspace, ManualClock()).refresh()

    signs = read_document(workspace.runtime_signal.read_text(), RUNTIME_SIGNAL).blocks["Signs"]
    assert sorted(each.reason for each in signs.requests) == ["", *["fire 🔥�"] * 3]
    assert {each.state for each in signs.requests} == {RequestState.WAITING}
