"""What a policy was shown and answered is kept as it was, and can be shown to another one."""

import numpy as np
import pytest

from phyagentos.errors import ExecutionError
from phyagentos.protocol.sessions.evidence import POLICY
from phyagentos.runtime.policies import wire
from phyagentos.runtime.policies.exchanges import ExchangeLog, read_arrays, read_exchanges

RNG = np.random.default_rng(3)
SHOWN = {
    "joint_state": RNG.normal(size=7),
    "gripper_width": np.array(0.08),
    "camera_rgb": RNG.integers(0, 256, (12, 16, 3), dtype=np.uint8),
    "history": RNG.integers(0, 256, (2, 12, 16, 3), dtype=np.uint8),
    "camera_depth": RNG.normal(size=(12, 16)).astype(np.float32),
}


def record(folder, *chunks):
    log = ExchangeLog(folder)
    for sequence, rows in enumerate(chunks):
        log.show(wire.Infer("s", sequence, 20 * sequence, 0.4 * sequence, SHOWN))
        log.answer(wire.Chunk(sequence=sequence, rows=rows, done=sequence == len(chunks) - 1))
    log.close()
    return read_exchanges(folder)


def test_every_bit_that_was_shown_and_answered_is_kept(tmp_path):
    rows = RNG.normal(size=(25, 8))
    (exchange,) = record(tmp_path, rows)
    arrays, answered = read_arrays(tmp_path, exchange)
    assert set(arrays) == set(SHOWN)
    for name, value in SHOWN.items():
        assert arrays[name].dtype == value.dtype
        assert np.array_equal(arrays[name], value)
    assert np.array_equal(answered, rows)
    assert (exchange.sequence, exchange.rows_done, exchange.done) == (0, 0, True)


def test_equal_exchanges_are_one_file(tmp_path):
    first, second, third = record(tmp_path, np.zeros((1, 8)), np.zeros((1, 8)), np.ones((1, 8)))
    assert first.file == second.file != third.file
    assert {path.name for path in tmp_path.iterdir()} == {POLICY, first.file, third.file}


def test_a_file_that_was_changed_is_not_believed(tmp_path):
    (exchange,) = record(tmp_path, np.zeros((1, 8)))
    path = tmp_path / exchange.file
    path.write_bytes(path.read_bytes().replace(b"rows", b"sows"))
    with pytest.raises(ExecutionError, match=r"EVIDENCE_DAMAGED: .*its bytes are not those of"):
        read_arrays(tmp_path, exchange)


def test_a_bundle_of_no_policy_says_so(tmp_path):
    with pytest.raises(ExecutionError, match=POLICY):
        read_exchanges(tmp_path)
