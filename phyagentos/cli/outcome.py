"""How a command ends: exit codes, and what each family of errors prints.

Results go to stdout, everything else to stderr, so that a command can be piped.
"""

import codecs
import os
import sys
import textwrap
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from enum import IntEnum
from io import TextIOWrapper
from itertools import islice
from pathlib import Path
from typing import IO

from phyagentos.errors import DefinitionError, PhyAgentOSError, Problem, find_full_disk
from phyagentos.protocol.documents.plain_text import clean


class ExitCode(IntEnum):
    """What the shell learns."""

    GOAL_MET = 0
    """Done, and for a goal: met on evidence."""
    GOAL_NOT_MET = 1
    """The run came to its end, the goal was not met."""
    INVALID_INPUT = 2
    """A file or an argument must be edited; nothing was started."""
    REJECTED = 3
    """Preflight refused a session; nothing moved for it."""
    INTERNAL_ERROR = 4
    """This program failed; the message names the log."""
    INTERRUPTED = 130
    """Ctrl-C."""


class Exit(Exception):
    """Ends a command with a code from any depth."""

    def __init__(self, code: ExitCode, message: str = "") -> None:
        self.code, self.message = code, message
        super().__init__(message)


def take_every_text() -> None:
    r"""Let stdout take every text: what its encoding lacks is written as in JSON (`\u2713`)."""
    codecs.register_error("json", _escape)
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="json")


def _escape(error: UnicodeError) -> tuple[str, int]:
    import json

    assert isinstance(error, UnicodeEncodeError), "stdout is written alone"
    return json.dumps(error.object[error.start : error.end])[1:-1], error.end


@contextmanager
def writing(stream: IO[str]) -> Iterator[None]:
    """Write to it: a reader that is gone, or notes that find no room, change no exit code; a lost result does."""
    try:
        yield
    except OSError as error:
        with Path(os.devnull).open("wb") as nowhere:  # from now on
            os.dup2(nowhere.fileno(), stream.fileno())
        if stream is sys.stdout and not isinstance(error, BrokenPipeError):
            raise OSError(error.errno, error.strerror, "standard output") from error


def print_note(text: str) -> None:
    """Text to stderr; on a terminal its lines are broken between words."""
    _print(sys.stderr, fold(clean(text), find_columns(sys.stderr)))


def find_columns(stream: IO[str] | None) -> int:
    """How many letters a line of a terminal has; 0 for what is none."""
    with suppress(OSError, ValueError):
        if stream is not None and stream.isatty():
            return os.get_terminal_size(stream.fileno()).columns
    return 0


def fold(text: str, columns: int) -> str:
    """Lines of at most so many letters, broken between words, what follows indented as its line; 0 breaks none."""
    if not columns:
        return text
    lines = [
        textwrap.wrap(
            line, columns, subsequent_indent=line[: len(line) - len(line.lstrip())],
            break_long_words=False, break_on_hyphens=False,
        ) if len(line) > columns else [line]
        for line in text.split("\n")
    ]  # fmt: skip
    return "\n".join(part for parts in lines for part in parts)


def print_result(text: str) -> None:
    """Text to stdout, with one newline at its end; names and reasons of others command no terminal."""
    _print(sys.stdout, clean(text).removesuffix("\n"))


def _print(stream: IO[str] | None, text: str) -> None:
    if stream is not None:  # it was closed before
        with writing(stream):
            stream.write(f"{text}\n")
            stream.flush()


def print_json(value: object) -> None:
    """A value of structs and plain data as indented JSON on stdout."""
    import msgspec

    print_result(msgspec.json.format(msgspec.json.encode(value, enc_hook=os.fspath), indent=2).decode())


def print_found(value: object, text: str, *, as_json: bool) -> None:
    """What a command found: the value as JSON, else the text."""
    if as_json:
        print_json(value)
    else:
        print_result(text)


PROBLEMS_SHOWN, PROBLEM_LETTERS = 500, 4000


def print_problems(problems: Iterable[Problem]) -> int:
    """Each problem on its own line of stderr, duplicates once, as many as anyone reads. Returns how many there are."""
    unique = dict.fromkeys(problems)
    for problem in islice(unique, PROBLEMS_SHOWN):
        print_note(str(problem).replace("\n", " ")[:PROBLEM_LETTERS])
    if len(unique) > PROBLEMS_SHOWN:
        print_note(f"and {len(unique) - PROBLEMS_SHOWN} more")
    return len(unique)


def report_exception(error: BaseException) -> ExitCode:
    """Print what a person needs of an exception and choose the exit code; tracebacks only where they were asked for."""
    if isinstance(
        error, AttributeError | ImportError | RuntimeError
    ):  # as MuJoCo raises with graphics that are not here
        from phyagentos.assembly.graphics import require_graphics

        try:
            require_graphics()
        except DefinitionError as refused:
            error = refused
    debug = "--debug" in sys.argv or os.environ.get("PAOS_DEBUG") == "1"  # which both planes inherit
    if isinstance(error, KeyboardInterrupt):
        return ExitCode.INTERRUPTED
    if isinstance(error, Exit):
        if error.message:
            print_note(error.message)
        return error.code
    if debug:
        traceback.print_exception(error, file=sys.stderr)
    if isinstance(error, DefinitionError):
        count = print_problems(error.problems)
        print_note(f"{count} problem{'s' if count != 1 else ''}")
        return ExitCode.INVALID_INPUT
    own = __name__.partition(".")[0]
    if isinstance(error, ModuleNotFoundError) and (error.name or own).partition(".")[0] != own:
        print_note(
            f"paos: this needs {error.name}, which is not installed here; a client only reads workspaces and decides."
        )
        print_note("Install all of it: pip install '.' in the checkout, or PATH_OF_THE_WHEEL.")
        return ExitCode.INVALID_INPUT
    if place := find_full_disk(error):
        print_note(f"{place}: no room is left on its disk. Make room, then do it again.")
        return ExitCode.INTERNAL_ERROR
    if isinstance(error, OSError) and error.filename is not None:
        print_note(f"{error.filename}: {error.strerror}; name a place that can be read and written")
        return ExitCode.INVALID_INPUT
    name = "" if isinstance(error, PhyAgentOSError) else f"{type(error).__name__}: "
    hint = "" if debug else " Add --debug for the traceback."
    print_note(f"paos: {name}{str(error).rstrip('.')}.{hint}")
    return ExitCode.INTERNAL_ERROR
