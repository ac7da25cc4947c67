"""The URDF that a xacro file stands for, with the values of its arguments."""

import contextlib
import io
import re
from collections.abc import Mapping
from pathlib import Path

from phyagentos.errors import DefinitionError, Problem
from phyagentos.runtime.models.meshes import iter_package_folders

_PACKAGES = 64  # that one file may name
_USED, _DECLARED = re.compile(r"\$\(arg (\w+)\)"), re.compile(r"""<xacro:arg\s+name=["'](\w+)["']\s+default=""")
_UNKNOWN_ARGUMENT = re.compile(r"Undefined substitution argument (\S+)")
_UNKNOWN_PACKAGE = re.compile(r"Package not found: (\S+)")
# What it says; then what was found, of which {0} is what the pattern's group holds, and what to write.
_REFUSALS = (
    (r"No such file or directory: '?([^'\s]*)", "no file {0!r}, which it reads", "a file at that path"),
    (r"name '(\w+)' is not defined|unknown macro name: (?:xacro:)?(\S+)", "{0!r}, which nothing defines",
     "a property or macro of this name"),
    (r"Undefined parameters \[([^\]]*)\]", "a macro that is called without {0}", "a value for each parameter"),
    (r'Invalid parameter "([^"]*)"', "the parameter {0!r}, which its macro does not have", "a parameter of the macro"),
    (r"variable '([^']*)' is not set", "the environment variable {0} without a value", "one that is set"),
    (r"((?:not well-formed|mismatched tag|no element found).*)", "no whole XML: {0}", "every tag closed"),
)  # fmt: skip


def expand_xacro(path: Path, arguments: Mapping[str, str]) -> str:
    """Expand a file; packages that it names are searched among the folders above it and below that of models.

    Raises:
        DefinitionError: `MODEL_INVALID` for whatever cannot be expanded, `UNREADABLE_FILE` for an absent package.
    """
    import xacro  # type: ignore[import-not-found, import-untyped, unused-ignore]
    from xacrodoc import packages  # type: ignore[import-not-found, import-untyped, unused-ignore]

    packages.walk_up_from(path)
    for _ in range(_PACKAGES):
        try:
            with contextlib.redirect_stderr(io.StringIO()):
                return str(xacro.process_file(str(path.resolve()), mappings=dict(arguments)).toxml())
        except Exception as error:  # of expressions that the file itself holds: any
            name = next(iter(_UNKNOWN_PACKAGE.findall(str(error))), "")
            found = next(
                (
                    each
                    for each in iter_package_folders(path.parent, name)
                    if name and each.name == name and each.is_dir()
                ),
                None,
            )
            if found is None:
                raise DefinitionError(_explain(str(error), name, path, arguments)) from error
            packages.update_package_cache({name: str(found)})
    raise DefinitionError.of("MODEL_INVALID", str(path), f"more than {_PACKAGES} packages", "fewer")


def _explain(text: str, package: str, path: Path, arguments: Mapping[str, str]) -> Problem:
    address = str(path)
    if package:
        hint = f"Put the folder {package} beside that of this file's package, or below that of PHYAGENTOS_MODELS."
        return Problem("UNREADABLE_FILE", address, f"no package {package!r}", "a folder of this name", hint)
    if missing := _UNKNOWN_ARGUMENT.findall(text):
        written = path.read_text(encoding="utf-8")
        names = sorted({*missing, *_USED.findall(written)} - {*_DECLARED.findall(written), *arguments})
        found, given = ", ".join(map(repr, names)), " ".join(f"--arg {name}=VALUE" for name in names)
        hint = f"To `paos robot new` give {given}; a profile has them as `arguments`."
        return Problem("MODEL_INVALID", address, f"no value for its arguments {found}", "a value for each", hint)
    for pattern, found, expected in _REFUSALS:
        if match := re.search(pattern, text):
            return Problem("MODEL_INVALID", address, found.format(next(filter(None, match.groups()), "")), expected)
    said = "; ".join(dict.fromkeys(line.strip() for line in text.splitlines() if line.strip())) or "nothing"
    return Problem("MODEL_INVALID", address, f"what cannot be expanded; xacro says: {said}", "a whole xacro file")
