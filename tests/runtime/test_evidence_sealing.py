"""The recorder writes into no file that other bundles share, and what computed a bundle is named in it."""

import ast
import sys
from pathlib import Path

from phyagentos.protocol.sessions import evidence
from phyagentos.protocol.sessions.evidence_manifest import MANIFEST, Sealer, check_bundle
from phyagentos.runtime.worker import recorder
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


def test_the_fingerprint_names_every_package_that_computes_a_motion():
    imported = set()
    for path in (Path(recorder.__file__).parents[1] / "motion").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                imported |= {each.name.partition(".")[0] for each in node.names}
            elif isinstance(node, ast.ImportFrom):
                imported.add(str(node.module).partition(".")[0])
    computing = imported - sys.stdlib_module_names - {"msgspec"}

    assert {"mink", "ompl", "toppra"} <= computing
    assert computing <= set(recorder.RECORDED_PACKAGES)
