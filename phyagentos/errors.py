"""The two families of errors, and the problem report that both carry.

`DefinitionError` means that a file must be edited; `ExecutionError` that the world did not permit it. Expected outcomes
(no path found, a session refused) are values, not exceptions.
"""

import difflib
import errno
import inspect
import shutil
import signal
import traceback
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import CodeType
from typing import TypeVar

import msgspec

from phyagentos.overtime import limit_time

LOAD_S = 60.0  # for a person's code to load: a library of models takes half of it
SHOWN = 40  # names in a message; of more the nearest ones
ROOM_BYTES = 1 << 20  # with less room than that no process can keep its records

_NameT = TypeVar("_NameT", bound=str)
_ValueT = TypeVar("_ValueT")


class Problem(msgspec.Struct, frozen=True, omit_defaults=True):
    """One finding about one place of one authored file or contract.

    Attributes:
        code: Stable name of the kind of problem, upper case (`UNKNOWN_NAME`, `JOINT_POSITION`).
        address: Where: `file:line:column`, or the dotted path inside a contract.
        found: The offending value, as a person wrote it.
        expected: What would have been possible.
        hint: What to do next; often the nearest valid name.
        triggered_by: What requires what is missing (a skill, a policy, a settings file), unless the address shows it.
        subject: The predicate or name that the finding is about, for programs; the other texts are for people.
        kind: What of it: what an unknown name should be the name of (`skill`), which property does not fit (`unit`).
    """

    code: str
    address: str
    found: str = ""
    expected: str = ""
    hint: str = ""
    triggered_by: str = ""
    subject: str = ""
    kind: str = ""

    @classmethod
    def unknown(
        cls, kind: str, address: str, name: str, possible: Iterable[str], found: str = "", by: str = "", fix: str = ""
    ) -> "Problem":
        """`UNKNOWN_NAME`: none of this kind is called so; with the nearest of the possible names, else `fix`.

        `found` is what was written, where that is more than the name; `by` is what requires it.
        """
        possible = tuple(possible)
        hint = format_hint(name, possible) or fix
        nearest = difflib.get_close_matches(name, possible, SHOWN, cutoff=0.0) if len(possible) > SHOWN else possible
        more = f" and {len(possible) - SHOWN} more" if len(possible) > SHOWN else ""
        expected = f"{format_names(nearest)}{more}"
        return cls("UNKNOWN_NAME", address, found or repr(name), expected, hint, by, name, kind)

    @property
    def label(self) -> str:
        """The code and, in brackets, the kind."""
        return f"{self.code} ({self.kind})" if self.kind else self.code

    def __str__(self) -> str:
        """One line: where, which, found, possible, next."""
        parts = [f"{self.address}: {self.label}"]
        if self.found:
            parts.append(f"found {self.found}")
        if self.expected:
            parts.append(f"expected {self.expected}")
        if self.triggered_by:
            parts.append(f"required by {self.triggered_by}")
        line = ": ".join((parts[0], "; ".join(parts[1:]))) if len(parts) > 1 else parts[0]
        return f"{line}. {self.hint}" if self.hint else line


def relocate(problems: Iterable[Problem], folder: Path) -> tuple[Problem, ...]:
    """Problems of files in a folder that will be gone: addresses without it."""
    return tuple(msgspec.structs.replace(each, address=each.address.replace(f"{folder}/", "")) for each in problems)


class PhyAgentOSError(Exception):
    """Root of every error this project raises on purpose."""


class DefinitionError(PhyAgentOSError):
    """A file must be edited. Carries every problem that was found, not only the first."""

    def __init__(self, problems: Problem | Sequence[Problem]) -> None:
        self.problems: tuple[Problem, ...] = (problems,) if isinstance(problems, Problem) else tuple(problems)
        super().__init__("\n".join(str(problem) for problem in self.problems))

    @classmethod
    def of(
        cls, code: str, address: str, found: str = "", expected: str = "", hint: str = "", kind: str = ""
    ) -> "DefinitionError":
        """The error of one `Problem`."""
        return cls(Problem(code, address, found, expected, hint, kind=kind))

    @classmethod
    def unknown(cls, kind: str, address: str, name: str, possible: Iterable[str]) -> "DefinitionError":
        """The error of one `Problem.unknown`."""
        return cls(Problem.unknown(kind, address, name, possible))


def raise_any(problems: Iterable[Problem]) -> None:
    """Raises DefinitionError with these problems, each once, where there are any."""
    if found := tuple(dict.fromkeys(problems)):
        raise DefinitionError(found)


def get_known(kind: str, address: str, name: _NameT, known: Mapping[_NameT, _ValueT]) -> _ValueT:
    """What has this name; raises DefinitionError as `DefinitionError.unknown` where nothing has."""
    if name not in known:
        raise DefinitionError.unknown(kind, address, name, known)
    return known[name]


class ExecutionError(PhyAgentOSError):
    """A process, a target, a file system or a motor did not do what was asked; `code` is like `TARGET_LOST`."""

    def __init__(self, code: str, message: str) -> None:
        self.code, self.message = code, message
        super().__init__(f"{code}: {message}")


class DefectError(ExecutionError):
    """What failed is a person's own code, at `place`: `file:line`, or the server that has it. To repeat it is vain."""

    def __init__(self, code: str, report: str, place: str) -> None:
        self.place = place
        super().__init__(code, report if place in report else f"{report} ({place})")


def is_defect(error: BaseException) -> bool:
    """Whether an exception of a person's code, such as a KeyError, is a defect that every repetition meets again."""
    return isinstance(error, DefectError) or not isinstance(error, PhyAgentOSError | OSError | MemoryError)


def list_foreign_errors() -> tuple[type[BaseException], ...]:
    """What to catch of a person's code: all but an interrupt from the keyboard, where this process hears of one."""
    hears = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    return tuple(kind for kind in BaseException.__subclasses__() if not (hears and kind is KeyboardInterrupt))


def find_place(error: BaseException, *own: object) -> str:
    """`file:line` of the deepest call in the files of a person's functions, classes or modules (a path).

    Where none is in them, as when an answer is refused, where the last of `own` begins; without any, the deepest call.
    """
    begins = {place[0]: place for each in own for place in _list_beginnings(each)}
    if isinstance(error, SyntaxError) and str(error.filename) in begins:
        return f"{error.filename}:{error.lineno or 1}"
    calls = [(call.filename, call.lineno or 1) for call in traceback.extract_tb(error.__traceback__)]
    inner = next((call for call in reversed(calls) if call[0] in begins), None)
    file, line = inner or [*calls[-1:], *begins.values()][-1]
    return f"{file}:{line}"


def _list_beginnings(own: object) -> list[tuple[str, int]]:
    """File and first line of each function of it."""
    if isinstance(own, Path):
        return [(str(own), 1)]
    parts = vars(own).values() if isinstance(own, type) else [own]
    codes = [getattr(inspect.unwrap(each), "__code__", None) for each in parts if callable(each)]
    return [(code.co_filename, code.co_firstlineno) for code in codes if isinstance(code, CodeType)]


def has_room(path: Path) -> bool:
    """Whether the disk of a path, or of the folder where it would be, can still take what a process records."""
    there = next(each for each in (path.absolute(), *path.absolute().parents) if each.exists())
    return shutil.disk_usage(there).free >= ROOM_BYTES


def find_full_disk(error: BaseException) -> str:
    """What a write found no room for, by the error or by the calls that led there; empty for any other error."""
    if isinstance(error, shutil.Error) and f"[Errno {errno.ENOSPC}]" in str(error):  # of the files of a folder
        return str(error.args[0][0][1])
    if not isinstance(error, OSError) or error.errno not in {errno.ENOSPC, errno.EDQUOT}:
        return ""
    if error.filename is not None:
        return str(error.filename2 or error.filename)
    known: list[object] = []
    for frame, _ in traceback.walk_tb(error.__traceback__):
        here = [*frame.f_locals.values(), *getattr(frame.f_locals.get("self"), "__dict__", {}).values()]
        known = [*here, *known]  # the innermost first
    paths = [each for each in known if isinstance(each, Path)]
    return str(next((each for each in paths if not has_room(each)), paths[0] if paths else "a file"))


@contextmanager
def blaming(call: str, *own: object, limit_s: float = LOAD_S) -> Iterator[None]:
    """Around a call of a person's code before anything moves: its errors become DefinitionError `BROKEN_PYTHON`.

    `own` is as of `find_place`; so is a call that takes longer than its limit [s].
    """
    try:
        with limit_time(limit_s):
            yield
    except PhyAgentOSError:
        raise
    except list_foreign_errors() as error:
        found = f"{call} raised {type(error).__name__}: {error}"
        raise DefinitionError.of(
            "BROKEN_PYTHON", find_place(error, *own), found, "no error", "Repair that line."
        ) from error


@contextmanager
def needs_extra(extra: str, command: str) -> Iterator[None]:
    """Around imports of packages that an extra brings: raises DefinitionError `EXTRA_MISSING` without them."""
    try:
        yield
    except ImportError as error:
        raise DefinitionError.of(
            "EXTRA_MISSING", command, str(error), f"the extra `{extra}`", format_install(extra)
        ) from error


def format_install(extra: str) -> str:
    """How to install an extra; no registry has this package, so from where it was installed."""
    return f"Install the extra: pip install '.[{extra}]' in the checkout, or 'PATH_OF_THE_WHEEL[{extra}]'."


def find_nearest(name: str, possible: Iterable[str]) -> str | None:
    """The known name most like `name`, or None when none is close."""
    matches = difflib.get_close_matches(name, list(possible), n=1, cutoff=0.6)
    return matches[0] if matches else None


def format_hint(name: str, possible: Iterable[str]) -> str:
    """`Did you mean 'x'?` when a close name exists that is another one, else an empty string."""
    nearest = find_nearest(name, possible)
    return f"Did you mean {nearest!r}?" if nearest not in (None, name) else ""


def format_names(names: Iterable[str]) -> str:
    """Sorted, comma-separated names for the `expected` part of a problem."""
    return ", ".join(sorted(names)) or "(none)"
