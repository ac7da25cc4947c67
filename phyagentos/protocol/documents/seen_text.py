"""Whether a text is seen as it is: no letters without a shape, no heaps of marks, no long runs of blanks.

Letters that renderers pass over are `Default_Ignorable_Code_Point` of Unicode's DerivedCoreProperties.txt (16.0.0).
Most of them are of the general categories below; the others stand in a table.
"""

import re
import unicodedata

BLANKS_MAX, MARKS_MAX = 16, 4  # in a row
_CATEGORIES = frozenset({"Cc", "Cf", "Co", "Cn", "Cs", "Zl", "Zp"})
_SPANS = (  # of Default_Ignorable_Code_Point, what is of other categories, or was so in some version
    "034F 115F-1160 17B4-17B5 180B-180F 2065 3164 FE00-FE0F FFA0 FFF0-FFF8 1BCA0-1BCA3 1D173-1D17A E0000-E0FFF "
    "2800 13441-13442 1D159"  # and the blanks of braille, hieroglyphs and notes, which are symbols
)
_IGNORABLE = frozenset(
    code
    for first, _, last in (span.partition("-") for span in _SPANS.split())
    for code in range(int(first, 16), int(last or first, 16) + 1)
)
_BLANKS = re.compile(rf"\s{{{BLANKS_MAX + 1},}}")


def find_unseen(text: str) -> list[str]:
    """What of a text is not seen, in words, each once; a line break and a tab are."""
    found = dict.fromkeys(f"U+{ord(each):04X}" for each in sorted(set(text) - set("\n\t")) if _is_unseen(each))
    if blanks := _BLANKS.search(text):
        found[f"{len(blanks[0])} blanks in a row"] = None
    base, marks = " ", 0
    for each in text if not text.isascii() else "":
        if not unicodedata.category(each).startswith("M"):
            base, marks = each, 0
            continue
        marks += 1
        if base.isspace():
            found[f"a mark on no letter, U+{ord(each):04X}"] = None
        elif marks > MARKS_MAX:
            found[f"more than {MARKS_MAX} marks on one letter"] = None
    return list(found)


def _is_unseen(letter: str) -> bool:
    return unicodedata.category(letter) in _CATEGORIES or ord(letter) in _IGNORABLE
