"""Every document has a page, and no page can rot: its fields and its excerpt are those of the model."""

import re
import shutil
import subprocess
import sys

import pytest

from phyagentos.cli.schemas import names_of_schemas, render_fields
from phyagentos.operations.describe import KINDS
from phyagentos.protocol.documents.document import iter_blocks
from phyagentos.protocol.documents.log import read_log
from phyagentos.protocol.settings.settings_files import SETTINGS_FILES
from phyagentos.store.document_registry import FORMATS, check_document
from tools.write_reference import BEGIN, END, renew_pages

from .values import check_schema

NAMES = {file: file.rpartition(".")[0].lower() for file in (*FORMATS, *SETTINGS_FILES)}


def read_page(root, file):
    return (root / "docs" / "documents" / f"{NAMES[file]}.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("file", NAMES)
def test_a_page_shows_every_field_of_the_model(root, file):
    assert f"{BEGIN}\n{render_fields(NAMES[file])}\n{END}" in read_page(root, file), "run `make schemas`"


@pytest.mark.parametrize("file", NAMES)
def test_a_page_says_who_writes_and_what_an_edit_does(root, file):
    page = read_page(root, file)
    for row in ("sole writer", "truth or view", "a person's edit", "module", "schema"):
        assert re.search(rf"^\| \*\*{row}\*\* \| \S.* \|$", page, re.MULTILINE), row
    module = re.search(r"`phyagentos\.protocol\.(\w+)\.(\w+)`", page)
    assert (root / "phyagentos" / "protocol" / module[1] / f"{module[2]}.py").is_file()
    assert f"]({'documents/' + NAMES[file]}.md)" in (root / "docs" / "documents.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("file", NAMES)
def test_every_field_has_a_meaning(file):
    rows = [line for line in render_fields(NAMES[file]).splitlines() if line.startswith("| `")]
    assert rows
    assert [row for row in rows if row.endswith("|  |")] == []


@pytest.mark.parametrize("file", FORMATS)
def test_the_excerpt_on_a_page_is_a_document(root, file):
    (excerpt,) = re.findall(r"^````markdown\n(.*?)^````$", read_page(root, file), re.MULTILINE | re.DOTALL)
    check_document(excerpt, file)
    check_schema(excerpt, file)
    assert list(iter_blocks(excerpt)) or read_log(excerpt).lines


@pytest.mark.parametrize("file", SETTINGS_FILES)
def test_the_excerpt_on_a_page_is_of_the_file_that_ships(root, file):
    (shown,) = re.findall(r"^````yaml\n(.*?)^````$", read_page(root, file), re.MULTILINE | re.DOTALL)
    assert shown in (root / "protocol" / file).read_text(encoding="utf-8")


def test_pages_are_renewed_between_their_marks(tmp_path):
    page = tmp_path / "sensors.md"
    page.write_text(f"# before\n\n{BEGIN}old\n{END}\n# after\n")
    (tmp_path / "other.md").write_text("# nothing to renew\n")

    assert renew_pages(tmp_path) == {page: f"# before\n\n{BEGIN}\n{render_fields('sensors')}\n{END}\n# after\n"}


@pytest.mark.parametrize("file", NAMES)
def test_links_between_pages_lead_somewhere(root, file):
    folder = root / "docs" / "documents"
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", re.sub(r"(?s)````.*?````", "", read_page(root, file))):
        assert (folder / target).exists(), target


def test_one_command_writes_schemas_documents_and_pages_as_they_are(root, tmp_path):
    shutil.copytree(root / "docs" / "documents", tmp_path / "docs" / "documents")
    subprocess.run([sys.executable, root / "tools" / "write_reference.py", "--root", tmp_path], check=True)

    written = [path for path in tmp_path.rglob("*") if path.is_file()]
    for path in written:
        assert path.read_bytes() == (root / path.relative_to(tmp_path)).read_bytes(), "run `make schemas`"
    assert len(list((tmp_path / "protocol" / "schemas").iterdir())) == len(names_of_schemas())
    assert len(list((tmp_path / "protocol").glob("*.md"))) == len(FORMATS)
    assert {path.name for path in (tmp_path / "docs" / "reference").iterdir()} == {f"{kind}.md" for kind in KINDS}
    assert (tmp_path / "docs" / "error_codes.md").is_file()
