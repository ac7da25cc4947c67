"""What a command answers: the struct of its operation, the same for people, and an exit code. `app` prints it."""

import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from phyagentos.cli.outcome import ExitCode, find_columns, fold, print_json, print_note, print_result
from phyagentos.errors import Problem

Found_co = TypeVar("Found_co", covariant=True)


@dataclass(frozen=True, slots=True)
class Reply(Generic[Found_co]):
    """What a command answers.

    Attributes:
        found: The struct of its operation, which is all that `--json` prints.
        text: The same for people on stdout: text, or what rich draws; nothing where it is empty.
        notes: For people on stderr.
        code: How the command ends.
        folds: Whether lines of a text may be broken between words on a terminal; not those that programs read.
    """

    found: Found_co
    text: object = ""
    notes: Sequence[str] = ()
    code: ExitCode = ExitCode.GOAL_MET
    folds: bool = True

    def print(self, *, as_json: bool) -> ExitCode:
        """Print it; the exit code."""
        if as_json:
            print_json(self.found)
            return self.code
        if self.text and isinstance(self.text, str):
            print_result(fold(self.text, find_columns(sys.stdout)) if self.folds else self.text)
        elif self.text:
            from phyagentos.cli.console import UNBOUNDED, CleanConsole

            console = CleanConsole(highlight=False)
            if console.is_terminal:
                console.print(self.text)
            else:
                console.width = UNBOUNDED
                with console.capture() as shown:
                    console.print(self.text)
                print_result("\n".join(map(str.rstrip, shown.get().splitlines())))
        for note in self.notes:
            print_note(note)
        return self.code


def list_problems(problems: Iterable[Problem]) -> list[str]:
    """Each problem on a line, duplicates once."""
    return [str(problem).replace("\n", " ") for problem in dict.fromkeys(problems)]
