"""What a mutant is: what the bent system claims, the edits of our own source for it, and the tests that must fail."""

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True, slots=True)
class Edit:
    """One replacement in one module.

    Attributes:
        module: Dotted name.
        was: Text that stands exactly once in its source, whatever white space is between its words.
        becomes: What stands there instead.
    """

    module: str
    was: str
    becomes: str

    @property
    def path(self) -> Path:
        """The file, of this project or of one of its kits, whose reading is bent, never the file itself."""
        relative = self.module.replace(".", "/") + ".py"
        return next(ROOT.glob(f"kits/*/{relative}"), ROOT / relative)

    def apply(self, source: str) -> str:
        """The bent source.

        Raises:
            ValueError: When `was` does not stand exactly once in it.
        """
        core = self.was.strip()
        before, after = self.was.split(core)
        words = r"\s+".join(map(re.escape, core.split()))
        pattern = re.escape(before) + words + re.escape(after)
        bent, count = re.subn(pattern, lambda _: self.becomes, source)
        if count != 1:
            raise ValueError(f"{self.path}: {self.was!r} stands there {count} times, expected once")
        return bent


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """One claim that is false of the honest system.

    Attributes:
        name: Its name in the table and on the command line.
        claim: What the bent system claims, in one sentence.
        edits: How its source is bent.
        tests: Node ids; each of them must turn red, whatever the others do.
    """

    name: str
    claim: str
    edits: tuple[Edit, ...]
    tests: tuple[str, ...]

    def bend(self) -> dict[str, str]:
        """The bent source of each module; edits of one module are made one after the other.

        Raises:
            ValueError: When the text of an edit does not stand exactly once in its module.
        """
        sources: dict[str, str] = {}
        for edit in self.edits:
            source = sources.get(edit.module) or edit.path.read_text(encoding="utf-8")
            sources[edit.module] = edit.apply(source)
        return sources
