"""docs/preflight.md names every code of preflight, and none that does not exist."""

import re

from phyagentos.codes import CODES, Phase
from phyagentos.protocol.capabilities.library import find_shipped_root

from .corpus import read_cases

PAGE = (find_shipped_root() / "docs" / "preflight.md").read_text(encoding="utf-8")
NAMED = set(re.findall(r"`([A-Z]+(?:_[A-Z]+)+)`", PAGE))


def test_every_code_of_the_phase_is_on_the_page():
    assert {name for name, code in CODES.items() if code.phase is Phase.PREFLIGHT} <= NAMED


def test_every_code_on_the_page_is_in_the_table():
    assert set(CODES) >= NAMED


def test_the_case_on_the_page_is_one_of_the_corpus():
    assert "name: velocity_wider_than_the_arm" in PAGE
    assert any(case.name == "velocity_wider_than_the_arm" for case in read_cases())
