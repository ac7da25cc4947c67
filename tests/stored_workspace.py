"""The workspace that version 0.1.0 recorded."""

import tarfile
from pathlib import Path

ARCHIVE = Path(__file__).parent / "cli" / "stored" / "tidy_table_0_1_0.tar.xz"


def unpack_stored(folder: Path) -> Path:
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(folder, filter="data")
    return folder / "tidy_table"
