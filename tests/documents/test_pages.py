"""The pages that are written from declarations and records are up to date, and every document stands on its page."""

import json
import re
import shutil
import subprocess
import sys

import pytest

from phyagentos.cli.schemas import names_of_schemas, render_fields
from phyagentos.operations.describe import KINDS
from phyagentos.protocol.settings.settings_files import SETTINGS_FILES
from phyagentos.store.document_registry import FORMATS
from tools.record import find_figures, make_record, read_arguments
from tools.write_reference import HEADLINES, MEASURED, read_records, render_measured, renew_headlines

pytestmark = pytest.mark.slow

RECORD = {
    "name": "kept",
    "what": "Cups that were kept level",
    "says": "{kept:.0f} of {all:.0f}",
    "command": "python benchmarks/kept.py",
    "commit": "0123456789ab",
    "date": "2026-11-28",
    "machine": "2 cores",
    "figures": {"kept": 19.0, "all": 20.0},
}


@pytest.mark.parametrize("file", [*FORMATS, *SETTINGS_FILES])
def test_a_document_stands_on_the_page_with_its_module(root, file):
    page = (root / "docs" / "documents.md").read_text(encoding="utf-8")
    assert f"`{file}`" in page
    modules = set(re.findall(r"`phyagentos\.protocol\.(\w+)\.(\w+)`", page))
    assert len(modules) >= len(FORMATS)
    assert {
        each for each in modules if not (root / "phyagentos/protocol" / each[0] / f"{each[1]}.py").is_file()
    } == set()


@pytest.mark.parametrize("file", [*FORMATS, *SETTINGS_FILES])
def test_every_field_has_a_meaning(file):
    rows = [line for line in render_fields(file.rpartition(".")[0].lower()).splitlines() if line.startswith("| `")]
    assert rows
    assert [row for row in rows if row.endswith("|  |")] == []


def test_one_command_writes_schemas_documents_and_pages_as_they_are(root, tmp_path):
    shutil.copyfile(root / "README.md", tmp_path / "README.md")
    subprocess.run([sys.executable, root / "tools" / "write_reference.py", "--root", tmp_path], check=True)

    written = [path for path in tmp_path.rglob("*") if path.is_file()]
    for path in written:
        assert path.read_bytes() == (root / path.relative_to(tmp_path)).read_bytes(), "run `make schemas`"
    assert len(list((tmp_path / "protocol" / "schemas").glob("*.json"))) == len(names_of_schemas())
    assert len(list((tmp_path / "protocol").glob("*.md"))) == len(FORMATS)
    assert {path.name for path in (tmp_path / "docs" / "reference").iterdir()} == {f"{kind}.md" for kind in KINDS}
    assert {path.name for path in (tmp_path / "docs").glob("*.md")} == {"error_codes.md", "measured.md"}


def test_a_figure_without_a_record_is_not_printed():
    before = "".join(("# Title\n", MEASURED[0], "| 60 of 60 |\n", MEASURED[1], "after\n"))
    assert "60 of 60" not in renew_headlines(before, {})
    name = HEADLINES[0]
    renewed = renew_headlines(before, {name: RECORD})
    assert f"| [Cups that were kept level](docs/measured.md#{name}) | 19 of 20 |" in renewed
    assert renewed.endswith("after\n")


def test_a_measured_figure_stands_with_command_commit_date_and_machine():
    page = render_measured({"kept": RECORD})
    assert "Cups that were kept level: 19 of 20." in page
    assert "`python benchmarks/kept.py`, commit 0123456789ab, 2026-11-28, 2 cores." in page
    assert "| `kept` | 19 |" in page


def test_options_of_a_record_may_stand_between_its_name_and_its_command():
    given = read_arguments(["guard", "--without", "ms", "--", "python", "x.py", "--seeds", "2"])
    assert (given.name, given.without, given.run) == ("guard", "ms", ["python", "x.py", "--seeds", "2"])


def test_every_record_is_whole():
    records = read_records()
    assert records
    for name, record in records.items():
        assert record.keys() == RECORD.keys(), name
        assert record["name"] == name
        assert re.fullmatch(r"[0-9a-f]{12}\+?", record["commit"]), name
        assert record["says"].format(**record["figures"])


def test_a_record_holds_the_figures_of_the_last_line_that_has_them():
    lines = ["text", json.dumps({"figures": {"a": 1}}), json.dumps({"figures": {"a": 2}, "holds": True}), "end"]
    assert find_figures(lines) == {"a": 2}
    with pytest.raises(ValueError, match="no line of the output is JSON with figures"):
        find_figures(["text"])


def test_a_record_is_refused_whose_sentence_names_no_figure_of_it():
    with pytest.raises(KeyError, match="b"):
        make_record("kept", "true", {"a": 1.0}, "what", "{b}")
