"""An emergency stop whose latch no disk takes: the arm comes to rest first, and stays there."""

import errno

import numpy as np
import pytest

from phyagentos.clock import SystemClock
from phyagentos.protocol.sessions.estop import is_latched
from phyagentos.protocol.sessions.stop_signals import Signal, drop_signal
from phyagentos.runtime.targets import stop_listener, wire
from phyagentos.testing import ManualClock

pytestmark = pytest.mark.sim


def test_the_arm_is_at_rest_before_the_disk_is_asked_and_nothing_is_accepted_while_it_is_full(
    make_rig, tmp_path, monkeypatch
):
    clock, rig = ManualClock(), make_rig()
    stops = stop_listener.StopListener(tmp_path, clock)
    rig.world._is_estopped, rig.world._keep_stop = stops.is_latched, stops.keep
    rig.load()
    rig.begin()
    motion = rig.plan(np.array(rig.profile.arm.home_rad) + 0.2)
    for q, qd in motion[: len(motion) // 2]:
        step = rig.send(rig.make_command(q, qd=qd))
    assert np.abs(step.target.qd_rad_s).max() > 0.05
    asked = []

    def refuse(*_):
        asked.append(rig.driver.controller.is_moving)
        raise OSError(errno.ENOSPC, "No space left on device")

    drop_signal(tmp_path, Signal(kind="estop", by="a button"), SystemClock())
    with monkeypatch.context() as full:
        full.setattr(stop_listener, "latch", refuse)
        replies = []
        for q, qd in motion[len(motion) // 2 :]:
            replies.append(rig.send(rig.make_command(q, qd=qd)))
            clock.advance(0.02)

    assert {reply.code for reply in replies} == {"ESTOPPED"}
    assert 1 <= len(asked) <= 4  # again, but not in every control period
    assert not any(asked)
    assert np.abs(rig.observe().target.qd_rad_s).max() < 0.01
    assert not is_latched(tmp_path)
    clock.advance(1.0)
    assert rig.world.handle(wire.Begin(session="t", epoch=2)).code == "ESTOPPED"
    assert is_latched(tmp_path)
    stops.close()
