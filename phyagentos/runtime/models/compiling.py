"""What MuJoCo's compiler refuses of a model, as one problem at its file, with the link or joint and what to write."""

import re
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from phyagentos.errors import DefinitionError, Problem, raise_any
from phyagentos.protocol.capabilities.targets import HAND
from phyagentos.runtime.models.sources import is_urdf

_ELEMENT = re.compile(r"Element name '([^']*)', id \d+(?:, line (\d+))?")
_TAG = re.compile(r"Element '([^']*)', line (\d+)")
_FLAT, _SHELL = re.compile(r"mesh volume is too small: (\S+)"), mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
_HEAD = re.compile(r"^(XML )?(parse )?error( \d+)?:\s*", re.IGNORECASE)
TURNS_RAD, CIRCLE_DEG = 4.0 * np.pi, 360.0  # further no joint of a robot turns; but without end
SMALL_RAD, HINGES = 0.22, 3  # joints, so many, that turn less are no arm
# What it says; then what was found, and what to write: {0} is the element, {1} what the pattern's group holds.
_REFUSALS = (
    (r"mass and inertia of moving bodies", "link {0}, which a joint moves, without mass or without inertia",
     "a mass and an inertia above zero, in its <inertial>"),
    (r"eigenvalues|A \+ B >= C|inertia must|mass must", "link {0} with an inertia that no solid has",
     "ixx, iyy, izz above zero [kg m^2], each at most the sum of the others, and products below these"),
    (r"range\[0\] should be smaller", "joint {0} with a lower limit above its upper one", "the lesser one first"),
    (r"unknown element '([^']*)'|'([^']*)' not found|unknown default class name '([^']*)'",
     "{1!r}, which nothing in the model is called", "the name of an element of the model"),
    (r"'([^']*)' does not have enough data", "<{0}> with too few numbers in {1}", "more numbers"),
    (r"axis too small", "joint {0} with an axis of no length", 'a direction, such as 0 0 1'),
    (r"size \d must be positive|sizes? .*positive", "a shape {0} that has no size", "sizes above zero [m]"),
    (r"element '([^']*)' is repeated in equality", "joint {1}, coupled with itself", "another joint that it follows"),
    (r"repeated (?:name|URDF name):? ?'?([^'\n]*)", "the name {1!r} twice", "a name of its own for each element"),
    (r"mesh volume is too small|faces of mesh|coplanar|qhull|at least 4 vertices", "mesh {0}, which encloses no volume",
     "a closed mesh, or a box, cylinder or sphere in its place"),
    (r"_decoder|decoder found for mesh", "mesh {0}, whose file is torn or too large",
     "an STL or OBJ file of 1 to 200000 triangles"),
    (r"missing element: '([^']*)'", "<{0}> without <{1}>", "both"),
    (r"required attribute missing: '([^']*)'", "<{0}> without {1}", "that attribute"),
    (r"bad format in attribute '([^']*)'", "<{0}> with {1} that is no number", "numbers"),
    (r"unrecognized (?:attribute|element): '([^']*)'|invalid keyword: '([^']*)'", "{1!r} in <{0}>",
     "what the reference of MJCF names"),
    (r"XML model type: '([^']*)'", "a file that begins with <{1}>", "<mujoco>, a MJCF, or <robot>, a URDF"),
    (r"plugin (\S+) not found", "the plugin {1}", "a model without plugins"),
    (r"mismatched|parse error|XML_ERROR", "no whole XML", "every tag closed"),
)  # fmt: skip


def compile_model(spec: mujoco.MjSpec, *paths: Path) -> mujoco.MjModel:
    """Compile what was read of `paths`: the arm's file first, then the hand's.

    A mesh that encloses no volume counts as a shell, in `spec` too.

    Raises:
        DefinitionError: `MODEL_INVALID`, `UNREADABLE_FILE`.
    """
    while True:
        try:
            model = spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            flat = _FLAT.search(str(error))
            mesh = spec.mesh(flat[1]) if flat else None
            if mesh is None or mesh.inertia == _SHELL:
                raise DefinitionError(explain(str(error), *paths)) from error
            mesh.inertia = _SHELL
        else:
            raise_any(_iter_odd_units(model, *paths))
            return model


def _iter_odd_units(model: mujoco.MjModel, *paths: Path) -> Iterator[Problem]:
    """Joints whose ranges are in degrees where radians are meant, and all those of a MJCF that are the other way round.

    What is beyond a circle in degrees too turns without end.
    """
    hinges = np.flatnonzero((model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE) & (model.jnt_limited > 0)).tolist()
    for joint in hinges:
        span, name = model.jnt_range[joint], model.joint(joint).name
        if TURNS_RAD < np.abs(span).max() <= CIRCLE_DEG:
            low, high = np.radians(span)
            yield Problem(
                "MODEL_INVALID",
                _locate(paths[-1] if HAND in name else paths[0], name.rpartition(HAND)[2]),
                f"joint {name!r} that turns from {span[0]:g} to {span[1]:g} rad",
                f"at most {TURNS_RAD:.4g} rad to either side",
                f"Are these degrees? Then write {low:.4g} and {high:.4g}.",
            )
    spans = np.ptp(model.jnt_range[hinges], axis=1) if hinges else np.zeros(0)
    if len(hinges) >= HINGES and not is_urdf(paths[0]) and spans.max() < SMALL_RAD:
        found = f"joints of which none turns by more than {np.degrees(spans.max()):.3g} degrees"
        hint = 'Are their ranges in radians? Then write <compiler angle="radian"/>.'
        yield Problem("MODEL_INVALID", str(paths[0]), found, "joints of an arm", hint)


def explain(text: str, *paths: Path) -> Problem:
    """The problem behind what MuJoCo says of a model."""
    element, tag = _ELEMENT.search(text), _TAG.search(text)
    name = element[1].rpartition(HAND)[2] if element else tag[1] if tag else ""
    path = paths[-1] if element and HAND in element[1] else paths[0]
    line = None if is_urdf(path) else element[2] if element else tag[2] if tag else None
    address = f"{path}:{line}" if line not in {None, "0"} else _locate(path, name if element else "")
    if opened := re.search(r"Error opening file '([^']*)'", text):
        return Problem("UNREADABLE_FILE", address, f"no file {opened[1]!r}", "a file at that path from the model")
    for pattern, found, expected in _REFUSALS:
        if match := re.search(pattern, text):
            held = next((each for each in match.groups() if each), "")
            named = repr(name) if element and name else name or "without a name"
            return Problem("MODEL_INVALID", address, found.format(named, held), expected)
    said = _HEAD.sub("", text.strip().splitlines()[0])
    found = f"{name!r}, of which MuJoCo says: {said}" if name else f"what MuJoCo refuses: {said}"
    return Problem("MODEL_INVALID", address, found, "a model that MuJoCo compiles")


def _locate(path: Path, name: str) -> str:
    """A file, with the line that names an element first."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace") if name else ""
    except OSError:
        text = ""
    match = re.search(rf"""<(?:link|joint|body|geom|mesh)\b[^>]*\bname\s*=\s*["']{re.escape(name)}["']""", text)
    return f"{path}:{text.count(chr(10), 0, match.start()) + 1}" if match else str(path)
