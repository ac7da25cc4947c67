"""Any Gymnasium environment as a target (`driver: gymnasium`), in a Python environment of its own.

`gymnasium.yaml` beside the target's profile names the environment, its interpreter, and how set-points become actions.
"""

import json
from pathlib import Path
from typing import Any

from phyagentos.errors import DefinitionError
from phyagentos.protocol.capabilities.environments import find_python
from phyagentos.protocol.capabilities.targets import TargetProfile
from phyagentos.protocol.documents.schema import read_yaml
from phyagentos.runtime.drivers.kit import ChildDriver, start_body

SETTINGS = "gymnasium.yaml"


def open_gymnasium(profile: TargetProfile, folder: Path, outcomes: Path | None = None) -> ChildDriver:
    """Start the environment and connect to it; its own success goes to the file `outcomes`, for who measures.

    Raises as `start_body`.
    """
    path = folder / SETTINGS
    data: Any = read_yaml(path).data
    if not isinstance(data, dict):
        raise DefinitionError.of("NO_DRIVER", str(path), "no mapping", "what docs/targets.md says of it")
    settings = data | {"target": profile.target, "step_s": profile.physics_step_s}
    settings["steps_per_command"] = round(profile.control_period_s / profile.physics_step_s)
    if outcomes is not None:
        outcomes.parent.mkdir(parents=True, exist_ok=True)
        settings.setdefault("outcomes", str(outcomes.absolute()))
    made = settings.pop("environment", None)
    python = settings.pop("python", "python3") if made is None else str(find_python(made))
    command = (python, "-m", "target_server.gymnasium_body")
    return start_body("gymnasium", profile, command, path, json.dumps(settings))
