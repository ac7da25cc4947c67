"""Where models of robots come from: the project itself, a package, MuJoCo Menagerie, or a folder of models.

`model:` of a profile is a path beside it, or `SOURCE:PATH`:

- `menagerie:franka_emika_panda/panda.xml`: MuJoCo Menagerie, as the package `mujoco-menagerie` keeps it or below
  `MENAGERIE_ROOT`; nothing is downloaded.
- `package:robosuite/models/assets/robots/panda/robot.xml`: a file that an installed package ships.
- `models:vendor/rm65_b/rm65_b.urdf`: a file below the folder that `PHYAGENTOS_MODELS` names.
"""

import importlib.util
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

from phyagentos.errors import DefinitionError, format_hint, format_install, format_names
from phyagentos.protocol.capabilities.targets import TargetProfile, is_beside
from phyagentos.protocol.documents.enclosure import leads_out

MODELS, MENAGERIE_ROOT = "PHYAGENTOS_MODELS", "MENAGERIE_ROOT"
SUFFIXES = (".xml", ".mjcf", ".urdf", ".xacro")


def find_model(model: str, folder: Path, environ: Mapping[str, str] = os.environ) -> Path:
    """The file of a model; `folder` is the profile's.

    Raises:
        DefinitionError: `UNREADABLE_FILE`, with the command that brings it; `LEADS_OUT`.
    """
    if is_beside(model):
        return folder / model
    source, _, path = model.partition(":")
    if leads_out(path):
        raise DefinitionError.of("LEADS_OUT", f"model {model!r}", path, f"a path below the source {source!r}")
    place, hint = _LOCATORS[source](path, environ)
    if place is not None and place.is_file():
        return place
    near = sorted(each.name for each in place.parent.glob("*.xml")) if place is not None else []
    raise DefinitionError.of(
        "UNREADABLE_FILE",
        f"model {model!r}",
        found=f"no file {place}" if place is not None else "no such source here",
        expected=format_names(near) if near else f"a MJCF or URDF file of {source}",
        hint=hint,
    )


def name_in_models(path: Path, environ: Mapping[str, str] = os.environ) -> tuple[str, Path | None]:
    """What a profile calls a model file, `models:PATH`, and the folder that `PHYAGENTOS_MODELS` must name for that.

    None for the folder where the variable names one already, in which the file is.
    """
    file, root = path.resolve(), Path(environ.get(MODELS) or path.parent).resolve()
    if file.is_relative_to(root) and environ.get(MODELS):
        return f"models:{file.relative_to(root)}", None
    return f"models:{file.name}", file.parent


@contextmanager
def look_in(folder: Path | None) -> Iterator[None]:
    """Let models be found below a folder, as where `PHYAGENTOS_MODELS` names it; unchanged for None."""
    before = os.environ.get(MODELS)
    if folder is not None:
        os.environ[MODELS] = str(folder)
    try:
        yield
    finally:
        if folder is not None:
            os.environ.pop(MODELS)
            os.environ.update({} if before is None else {MODELS: before})


def find_models(profile: TargetProfile, folder: Path) -> list[Path]:
    """The files that a profile names: its model, then its hand; as of `find_model`."""
    named = (profile.model, profile.hand.model if profile.hand is not None else "")
    return [find_model(model, folder) for model in named if model]


def require_models(profile: TargetProfile, folder: Path) -> None:
    """Raise `UNREADABLE_FILE`, `LEADS_OUT` or `MODEL_INVALID` unless the models that a profile names can be read."""
    for path in find_models(profile, folder):
        require_reader(path)


def is_urdf(path: Path) -> bool:
    """Whether a file is a URDF or a xacro file: by its name, or by the first element of one that is called .xml."""
    if path.suffix in {".urdf", ".xacro"}:
        return True
    try:
        with path.open("rb") as file:
            return bool(next(ElementTree.iterparse(file, ("start",)))[1].tag == "robot")
    except (ElementTree.ParseError, ValueError, LookupError, OSError):  # MuJoCo says it better
        return False


def require_reader(path: Path) -> None:
    """Raise `MODEL_INVALID` for what is no model, and a xacro file where what expands it is not installed."""
    if path.suffix not in SUFFIXES:
        found, expected = f"a file called {path.suffix or path.name!r}", f"a model of a robot: {', '.join(SUFFIXES)}"
        raise DefinitionError.of("MODEL_INVALID", str(path), found, expected, "Name it by what it is.")
    if path.suffix == ".xacro" and importlib.util.find_spec("xacrodoc") is None:
        raise DefinitionError.of("MODEL_INVALID", str(path), "a xacro file", "a URDF file", format_install("xacro"))


def _locate_in_models(path: str, environ: Mapping[str, str]) -> tuple[Path | None, str]:
    folder = environ.get(MODELS)
    return Path(folder) / path if folder else None, f"Set {MODELS} to the folder that holds {path}."


def _locate_in_package(path: str, environ: Mapping[str, str]) -> tuple[Path | None, str]:
    name = path.partition("/")[0]
    spec = importlib.util.find_spec(name)
    places = list(spec.submodule_search_locations or ()) if spec is not None else []
    return Path(places[0]).parent / path if places else None, f"Install it: pip install {name}"


def _locate_in_menagerie(path: str, environ: Mapping[str, str]) -> tuple[Path | None, str]:
    """In a checkout, in the folder of models, or in the cache of the package."""
    name, _, file = path.partition("/")
    fetch = f"pip install mujoco-menagerie && mujoco-menagerie prefetch {name}"
    hint = f"Bring it: {fetch}, or set {MENAGERIE_ROOT} to a checkout."
    if root := environ.get(MENAGERIE_ROOT):
        return Path(root) / path, hint
    models = environ.get(MODELS)
    if models and (Path(models) / "menagerie").is_dir():
        return Path(models) / "menagerie" / path, hint
    if importlib.util.find_spec("mujoco_menagerie") is None:
        return None, hint
    import mujoco_menagerie  # type: ignore[import-not-found, unused-ignore]

    if name not in mujoco_menagerie.names():
        return None, format_hint(name, mujoco_menagerie.names()) or hint
    return mujoco_menagerie.Cache().model_path(mujoco_menagerie.get(name)) / file, hint


_LOCATORS = {"menagerie": _locate_in_menagerie, "package": _locate_in_package, "models": _locate_in_models}
