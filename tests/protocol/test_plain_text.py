"""Text that any document can hold."""

import msgspec
import pytest
import yaml

from phyagentos.protocol.documents.plain_text import clean


@pytest.mark.parametrize("text", ["", "a hand in the cell", "Gefäß\tüber\n7 °C", "🔥", "\x85\xa0\u2028\ufeff"])
def test_what_a_document_can_hold_stays(text):
    assert clean(text) == text


@pytest.mark.parametrize(
    ("text", "cleaned"),
    [
        ("too close\x7f", "too close�"),
        ("\x00\x1b[0m\x9b\ufffe", "��[0m��"),
        ("fire \ud83d\udd25", "fire 🔥"),
        ("\ud83d", "�"),
        ("a\udd25\ud83db", "a��b"),
        ("Gef\udce4\udcdf", "Gef��"),  # bytes of another encoding, as Python passes them on
    ],
)
def test_what_none_can_hold_is_replaced(text, cleaned):
    assert clean(text) == cleaned
    assert msgspec.json.decode(msgspec.json.encode(clean(text))) == cleaned
    assert yaml.safe_load(msgspec.json.encode(clean(text))) == cleaned
