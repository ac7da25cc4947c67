"""What stands in a bundle is what was measured, at the time that its name says."""

import hashlib

import numpy as np
import pytest
import yaml

from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence import read_bundle
from phyagentos.protocol.sessions.session import Ended
from phyagentos.runtime.targets import wire

from .conftest import PerfectTarget

LAG_RAD = 0.001


class LaggingTarget(PerfectTarget):
    """Stands a little before where it was told to be, and takes pictures that show the time."""

    def handle(self, request):
        if isinstance(request, wire.InvokeTool) and request.name == wire.RENDER:
            return wire.ToolResult({"picture.png": wire.Artefact("image/png", b"PNG %.3f s" % self.time_s)})
        return super().handle(request)

    def _describe(self):
        told = super()._describe()
        return wire.Description(
            **{name: getattr(told, name) for name in told.__struct_fields__} | {"cameras": ("front",)}
        )

    def _carry_out(self, command):
        super()._carry_out(command)
        self.q = self.q - LAG_RAD
        return self._step()


@pytest.fixture
def recorded(build_bench, build_session, profile):
    bench = build_bench(LaggingTarget(profile))
    bench.runner.bundles.pictures = True
    bench.target.q = bench.target.q + 0.3
    session = build_session(skill="home", parameters={})
    execution = bench.run(session)
    assert execution.ended is Ended.COMPLETED
    return read_bundle(bench.workspace / execution.evidence, session, execution)


def test_the_trajectory_holds_what_was_measured_beside_what_was_commanded(recorded):
    with np.load(recorded.folder / evidence.TRAJECTORY) as course:
        lag = course["q_commanded"] - course["q_measured"]

    assert len(lag) == recorded.execution.ticks
    assert lag == pytest.approx(LAG_RAD)


def test_the_end_of_a_bundle_is_the_world_as_it_was_left(recorded, profile):
    before, after = recorded.before, recorded.after
    home = np.array(profile.arm.home_rad)

    assert before.time_s == 0.0 < after.time_s
    for name, snapshot, q_rad in ((evidence.INITIAL, before, home + 0.3), (evidence.TERMINAL, after, home - LAG_RAD)):
        with np.load(recorded.folder / name) as state:
            assert state["time"] == snapshot.time_s
            assert state["qpos"] == pytest.approx(q_rad)
            assert snapshot.targets["panda"].q_rad == tuple(state["qpos"].tolist())
    for name, snapshot in ((evidence.PICTURE_BEFORE, before), (evidence.PICTURE_AFTER, after)):
        assert (recorded.folder / name).read_bytes() == b"PNG %.3f s" % snapshot.time_s


def test_a_bundle_names_the_settings_that_were_in_force_not_those_that_lie_there_later(
    tmp_path, build_bench, build_session
):
    path = tmp_path / "safety.yaml"
    path.write_text("in force")
    in_force = hashlib.sha256(path.read_bytes()).hexdigest()
    bench = build_bench(settings=(path,))
    path.write_text("edited since")

    execution = bench.run(build_session(skill="home", parameters={}))

    contract = yaml.safe_load((bench.workspace / execution.evidence / evidence.CONTRACT).read_text())
    assert contract["settings_sha256"] == {"safety.yaml": in_force}
