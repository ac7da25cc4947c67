"""The settings files that people own, and how each is checked.

Each is hashed into every evidence bundle. No skill, tree, prompt or memory can write them.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path

from phyagentos.protocol.documents.schema import Authored
from phyagentos.protocol.settings.perception import Perception, read_perception
from phyagentos.protocol.settings.runtime_contract import RuntimeContract, read_runtime_contract
from phyagentos.protocol.settings.safety import Safety, read_safety
from phyagentos.protocol.settings.sensors import Sensors, read_sensors

SETTINGS_FILES: dict[str, type[Authored]] = {
    "safety.yaml": Safety,
    "sensors.yaml": Sensors,
    "perception.yaml": Perception,
    "runtime_contract.yaml": RuntimeContract,
}
_READERS: dict[str, Callable[[Path], Authored]] = {
    "safety.yaml": read_safety,
    "sensors.yaml": read_sensors,
    "perception.yaml": read_perception,
    "runtime_contract.yaml": read_runtime_contract,
}


def compute_file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes, hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def check_settings(path: Path) -> None:
    """Check one of the settings files by its name.

    Raises:
        DefinitionError: With every problem.
    """
    _READERS[path.name](path)
