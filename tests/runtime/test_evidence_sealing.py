"""The recorder writes into no file that other bundles share."""

from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence_manifest import MANIFEST, Sealer, check_bundle
from phyagentos.runtime.worker.recorder import Recorder


def test_a_reconciled_session_writes_into_its_own_files_only(tmp_path):
    picture = b"picture" * 20_000
    sealer = Sealer(tmp_path)
    for name in ("g.a", "g.b"):
        Recorder(tmp_path / name).write_file(evidence.PICTURE_AFTER, picture)
        sealer.seal(tmp_path / name)
    assert (tmp_path / "g.a" / evidence.PICTURE_AFTER).samefile(tmp_path / "g.b" / evidence.PICTURE_AFTER)

    recorder = Recorder(tmp_path / "g.b")  # its runner was lost: the world is observed once more
    assert not (tmp_path / "g.b" / MANIFEST).exists()
    recorder.write_file(evidence.PICTURE_AFTER, b"later" * 20_000)
    sealer.seal(tmp_path / "g.b")

    assert (tmp_path / "g.a" / evidence.PICTURE_AFTER).read_bytes() == picture
    assert check_bundle(tmp_path / "g.a") == check_bundle(tmp_path / "g.b") == []
