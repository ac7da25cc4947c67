"""The settings files against which sessions are checked, read together."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from phyagentos.errors import DefinitionError, Problem
from phyagentos.protocol.settings.perception import Perception, read_perception
from phyagentos.protocol.settings.runtime_contract import RuntimeContract, read_runtime_contract
from phyagentos.protocol.settings.safety import TargetLimits, get_target_limits, read_safety
from phyagentos.protocol.settings.sensors import Sensors, read_sensors
from phyagentos.protocol.workspace.workspace import Workspace

ValueT = TypeVar("ValueT")


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """The settings of one target and its workspace."""

    limits: TargetLimits
    sensors: Sensors
    perception: Perception
    contract: RuntimeContract


def read_settings(workspace: Workspace, target: str) -> Settings:
    """The settings of a workspace, for one target; raises DefinitionError with every problem of all four files."""
    problems: list[Problem] = []

    def attempt(read: Callable[[], ValueT]) -> ValueT | None:
        try:
            return read()
        except DefinitionError as error:
            problems.extend(problem for problem in error.problems if problem not in problems)
            return None

    limits = attempt(lambda: get_target_limits(read_safety(workspace.safety), target, str(workspace.safety)))
    sensors = attempt(lambda: read_sensors(workspace.sensors))
    perception = attempt(lambda: read_perception(workspace.perception))
    contract = attempt(lambda: read_runtime_contract(workspace.runtime_contract))
    if sensors is not None and contract is not None and contract.record is not None:
        at = f"{workspace.runtime_contract}: record.cameras"
        unknown = [name for name in contract.record.cameras if name not in sensors.cameras]
        problems += [Problem.unknown("camera", at, name, sensors.cameras) for name in unknown]
    if problems or limits is None or sensors is None or perception is None or contract is None:
        raise DefinitionError(problems)
    return Settings(limits=limits, sensors=sensors, perception=perception, contract=contract)
