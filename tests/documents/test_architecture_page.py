"""The drawn page names files and rooms that exist."""

import re

import pytest

NAMED = re.compile(r"`([a-z_]+/(?:[a-z_]+/)*(?:[a-z_]+\.py)?)`")


def test_every_file_and_room_on_the_architecture_page_exists(root):
    page = (root / "docs" / "architecture.md").read_text(encoding="utf-8")
    named = set(NAMED.findall(page)) - {"phyagentos/", "docs/"}
    assert len(named) > 30
    assert {path for path in named if not (root / "phyagentos" / path).exists()} == set()


@pytest.mark.parametrize("room", ["agent", "runtime", "store", "protocol", "cli", "bench", "assembly"])
def test_every_room_stands_on_the_architecture_page(root, room):
    assert f"`{room}/`" in (root / "docs" / "architecture.md").read_text(encoding="utf-8")
