"""The settings files that people own, and how each is checked.

Each is hashed into every evidence bundle. No skill, tree, prompt or memory can write them.
"""

import hashlib
import re
from collections.abc import Callable
from pathlib import Path

from phyagentos.protocol.documents.markdown import publish
from phyagentos.protocol.documents.regular_files import read_regular
from phyagentos.protocol.documents.schema import Authored, read_text
from phyagentos.protocol.settings.perception import Perception, read_perception
from phyagentos.protocol.settings.runtime_contract import RuntimeContract, read_runtime_contract
from phyagentos.protocol.settings.safety import Safety, read_safety
from phyagentos.protocol.settings.sensors import Sensors, read_sensors

_FILES: dict[str, tuple[type[Authored], Callable[[Path], Authored]]] = {
    "safety.yaml": (Safety, read_safety),
    "sensors.yaml": (Sensors, read_sensors),
    "perception.yaml": (Perception, read_perception),
    "runtime_contract.yaml": (RuntimeContract, read_runtime_contract),
}
SETTINGS_FILES: dict[str, type[Authored]] = {name: model for name, (model, _) in _FILES.items()}


def compute_file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal."""
    return hashlib.sha256(read_regular(path)).hexdigest()


def check_settings(path: Path) -> Authored:
    """Read one of the settings files by its name; raises DefinitionError with every problem at file:line:column."""
    return _FILES[path.name][1](path)


def declare(path: Path, **values: object) -> None:
    """Write values into one of the settings files, which is hashed into the evidence; comments stay, and what is None.

    Raises DefinitionError with every problem of the file.
    """
    wanted = {key: value for key, value in values.items() if value is not None}
    if not wanted:
        return
    found, text = _FILES[path.name][1](path), (before := read_text(path))
    for key, value in wanted.items():
        if getattr(found, key) != value:
            line = f"{key}: {value}"
            text, count = re.subn(rf"(?m)^{key}:[ \t]*[\"']?[\w.]+[\"']?", line, text)
            text = text if count else f"{text.rstrip()}\n{line}\n"
    if text != before:
        publish(path, text)
