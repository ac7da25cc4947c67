"""What a sabotage is: a lie, the edits of our own source that tell it, and the tests that must not believe it.

Upstream: `sabotages`, the register. Downstream: `running`, which plants one; `table`, which shows them all.
"""

from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True, slots=True)
class Edit:
    """One replacement in one module.

    Attributes:
        module: Dotted name.
        was: Text that stands exactly once in its source.
        becomes: What stands there instead.
    """

    module: str
    was: str
    becomes: str

    @property
    def path(self) -> Path:
        """The file that would be bent; only its reading is, never the file."""
        root = ROOT if self.module.startswith("phyagentos.") else ROOT / "kits" / "rollouts"
        return root / (self.module.replace(".", "/") + ".py")

    def apply(self, source: str) -> str:
        """The bent source.

        Raises:
            ValueError: When `was` does not stand exactly once in it.
        """
        if (count := source.count(self.was)) != 1:
            raise ValueError(f"{self.module}: {self.was!r} stands there {count} times")
        return source.replace(self.was, self.becomes)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sabotage:
    """One lie.

    Attributes:
        name: How it is called in the table and by `-k`.
        lie: What the sabotaged system pretends, in one sentence.
        edits: How its source is bent.
        tests: Node ids; each of them must turn red, whatever the others do.
    """

    name: str
    lie: str
    edits: tuple[Edit, ...]
    tests: tuple[str, ...]
