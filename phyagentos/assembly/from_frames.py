"""Perceives again what a session observed: the runtime's perception on the looks of a bundle, without any world.

Neither a simulator nor ground truth is used: the only model loaded is the robot's own, to mask it in pictures.
"""

from phyagentos.assembly.processes import open_world_model
from phyagentos.errors import DefinitionError, ExecutionError, Problem
from phyagentos.protocol.capabilities.registries import get_registered_target
from phyagentos.protocol.documents.schema import read_yaml
from phyagentos.protocol.sessions.evidence import CONTRACT
from phyagentos.protocol.sessions.looks import LOOKS, LookEntry, read_looks
from phyagentos.protocol.sessions.session import SessionStatus
from phyagentos.protocol.settings.settings_files import compute_file_hash
from phyagentos.protocol.workspace.workspace import Workspace
from phyagentos.protocol.world.environment import Environment
from phyagentos.runtime.perception.look import RecordedFrames
from phyagentos.runtime.perception.look_file import read_look
from phyagentos.runtime.perception.perceived_world import PerceivedWorld
from phyagentos.runtime.preflight.settings import read_settings


def perceive_again(workspace: Workspace, status: SessionStatus) -> list[tuple[LookEntry, Environment]]:
    """Each look that a session's bundle names, and the world as perception makes it of that look now.

    Raises:
        ExecutionError: `LOOK_MISSING` or `EVIDENCE_UNREADABLE`, which name the file; `LOOK_DIFFERS` where perception
            now reads something else than it did.
        DefinitionError: `SETTINGS_CHANGED` where the settings are not those of the session.
    """
    execution, target = status.execution, status.contract.target
    folder = workspace.root / execution.evidence if execution is not None else workspace.evidence / status.contract.id
    entries = read_looks(folder)
    if not entries:
        found = "its sensing was truth, its target has no camera, or an earlier version recorded it"
        raise ExecutionError("LOOK_MISSING", f"{folder / LOOKS}: no look was recorded; {found}")
    recorded = read_yaml(folder / CONTRACT).data.get("settings_sha256", {})
    found = "another file than the session ran with"
    hint = f"Restore it, or judge on the snapshots: `paos verify {folder.name}` without --from-frames."
    changed = [
        Problem("SETTINGS_CHANGED", str(path), found, f"sha256 {recorded[path.name]}", hint)
        for path in (workspace.perception, workspace.sensors)
        if path.name in recorded and compute_file_hash(path) != recorded[path.name]
    ]
    if changed:
        raise DefinitionError(changed)
    looks = {entry.file: read_look(folder / entry.file, entry.sha256) for entry in entries}
    profile = get_registered_target(workspace.target_registry, target)
    eyes = RecordedFrames(next(iter(looks.values())))
    world = open_world_model(workspace, target, profile, eyes, read_settings(workspace, target))
    if not isinstance(world, PerceivedWorld):
        raise ExecutionError("LOOK_DIFFERS", f"{workspace.perception}: sensing is truth, the session's was perceived")
    worlds = {file: world.repeat(look) for file, look in looks.items()}
    return [(entry, worlds[entry.file]) for entry in entries]
