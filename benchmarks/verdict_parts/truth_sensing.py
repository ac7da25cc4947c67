"""What the verifier is shown when the simulator's own state is believed, and when what is told of it is a lie."""

import msgspec
import numpy as np

from benchmarks.verdict_parts.cases import Lie
from benchmarks.verdict_parts.worlds import World
from phyagentos.protocol.world.environment import Environment, Status

AGE_S = (1.5, 8.0)  # of what is stale
SILENT_S = (0.2, 0.9)
SENSING = "truth"


def look(world: World, revision: int = 2) -> Environment:
    """The world as it is."""
    physics, scene = world.physics, world.recorded.bundle.session.scene
    target = world.recorded.bundle.session.target
    physics.queries.look()
    state = physics.queries.read_target(physics.queries.find_touching())
    entities = physics.queries.read_entities(dict.fromkeys(state.holding, target))
    return Environment(
        time_s=physics.time_s,
        scene=scene.name,
        episode=scene.episode,
        revision=revision,
        sensing=SENSING,
        entities={entity.name: entity for entity in entities},
        regions={region.name: region for region in physics.scene.regions},
        targets={target: state},
    )


def lie_about(now: Environment, right: Environment, thing: str, lie: Lie, rng: np.random.Generator) -> Environment:
    """What is told of a world that is `now`, by sensors that last told the truth when it was `right`.

    The arm's own sensors never lie here. A frozen picture cannot be had of a simulator's state; its stamps are old.
    """
    if lie in {Lie.NONE, Lie.MOVING, Lie.EARLIER}:
        return now
    if lie is Lie.COVERED:
        return cover(now, thing)
    if lie in {Lie.SILENT, Lie.BLIND}:
        seen_s = now.time_s - float(rng.uniform(*SILENT_S))
        unseen = {
            name: msgspec.structs.replace(each, observed_at_s=seen_s, status=Status.HIDDEN)
            for name, each in right.entities.items()
        }
        return msgspec.structs.replace(now, entities=unseen)
    if lie is Lie.HIDDEN:
        hidden = msgspec.structs.replace(right.entities[thing], visible=False)
        return msgspec.structs.replace(now, entities={**now.entities, thing: hidden})
    seen_s = now.time_s - float(rng.uniform(*AGE_S))
    old = {name: msgspec.structs.replace(each, observed_at_s=seen_s) for name, each in right.entities.items()}
    return msgspec.structs.replace(now, entities=old)


def cover(world: Environment, thing: str) -> Environment:
    """The same without a thing that no look has ever shown."""
    rest = {name: each for name, each in world.entities.items() if name != thing}
    return msgspec.structs.replace(world, entities=rest, never_seen=(thing,))
