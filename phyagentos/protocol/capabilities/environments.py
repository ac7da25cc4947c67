"""Python environments of other systems: what a suite declares, `paos bench setup` makes and a driver starts.

An environment is a virtual environment in the folder `PHYAGENTOS_ENVIRONMENTS`, else in `build/`, under its own name.
"""

import os
from collections.abc import Mapping
from pathlib import Path

import pydantic
from packaging.requirements import InvalidRequirement, Requirement

from phyagentos.protocol.documents.schema import Authored, misfit

ENVIRONMENTS, DEFAULT_FOLDER = "PHYAGENTOS_ENVIRONMENTS", "build"


class CheckoutSpec(Authored):
    """A clone of a repository that a user has: its files are used where they are, and never copied.

    Attributes:
        url: Of the repository.
        revisions: Of each folder of it that is a repository, `.` for the whole, the commit that is known to work.
        files: What must be there, as assets that a clone may lack.
        paths: Folders from which modules are imported.
    """

    url: str
    revisions: dict[str, str] = {}
    files: tuple[str, ...] = ()
    paths: tuple[str, ...] = pydantic.Field(min_length=1)


class EnvironmentSpec(Authored):
    """One Python environment.

    Attributes:
        packages: What pip installs, as requirements (`mujoco==3.3.0`).
        without_dependencies: Packages installed afterwards with `--no-deps`, since their own pins do not fit.
        imports: Modules that must be found in it.
        files: What must be there beside it, of a program that paos does not install; `about` says what does.
        checkout: What is not on the registry: `paos bench setup NAME --from FOLDER` says where its clone is.
        gigabytes: Disk that it takes, about [GB].
        about: For whom makes it: licences, how long it takes.
    """

    packages: tuple[str, ...] = ()
    without_dependencies: tuple[str, ...] = ()
    imports: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    checkout: CheckoutSpec | None = None
    gigabytes: float = pydantic.Field(default=0.0, ge=0.0)
    about: str = ""

    @pydantic.model_validator(mode="after")
    def _check_requirements(self) -> "EnvironmentSpec":
        if not (self.packages or self.files):
            raise misfit("packages", "packages of pip, or files of a program", "Name what it needs.")
        for key in ("packages", "without_dependencies"):
            for text in getattr(self, key):
                try:
                    Requirement(text)
                except InvalidRequirement as error:
                    raise misfit(key, "requirements of pip, such as mujoco==3.3.0", f"{text!r} is none.") from error
        return self


def find_python(name: str, environ: Mapping[str, str] = os.environ) -> Path:
    """The interpreter of an environment, whether it is there or not; relative to where `paos` was started."""
    return Path(environ.get(ENVIRONMENTS) or DEFAULT_FOLDER) / name / "bin" / "python"
