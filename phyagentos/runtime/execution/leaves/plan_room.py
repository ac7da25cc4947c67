"""Ask what has to go before there is room for an object where it is put."""

from phyagentos.geometry import Vector
from phyagentos.protocol.predicates.meaning import find_relation
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.free_spot import find_filling, find_free_spot, find_support, take_off
from phyagentos.runtime.execution.leaf import PortInformation, Role, Status
from phyagentos.runtime.execution.leaves.plan_grasp import PlanGrasp
from phyagentos.runtime.execution.planning import PlanningLeaf
from phyagentos.runtime.execution.port_types import Names
from phyagentos.runtime.motion.requests import (
    Approaches,
    Destination,
    FindGrasps,
    MotionRequest,
    NoPlan,
)


class PlanRoom(PlanningLeaf[Approaches]):
    """The fewest objects to move away, and where to; none where there is room, or where moving gives none."""

    ROLE = Role.PLAN_ROOM
    INPUT_PORTS = {port: PlanGrasp.INPUT_PORTS[port] for port in ("object", "destination", "relation", "near")}
    OUTPUT_PORTS = {
        "things": PortInformation(data_type=Names, description="What has to go, the first one first."),
        "support": PortInformation(data_type=str, description="Entity to put them on."),
        "to": PortInformation(data_type=tuple, description="Where about, world frame [m]."),
    }

    def compose(self) -> MotionRequest | Status:
        """One request, where the destination holds anything that may be moved."""
        now, name = self.belief, self.read("object")
        then = Destination(self.read("destination"), find_relation(self.read("relation")), self.find_point("near"))
        if not (objects := list_removable(self.context.session, now, name, then.name)):
            return self._leave()
        return self.request(FindGrasps, object=name, count=1, then=then, removable=objects)

    def on_answer(self, answer: Approaches) -> Status:
        """Write what has to go."""
        now, profile, place = self.belief, self.context.profile, self.read("destination")
        here_m = now.entities[self.read("object")].pose.position_m
        there_m = (now.regions.get(place) or now.entities[place]).pose.position_m
        middle_m = ((here_m[0] + there_m[0]) / 2, (here_m[1] + there_m[1]) / 2, here_m[2])
        for first in answer.gone[:1]:
            beside = take_off(now, first, {place})
            support, needed = find_support(beside, first), (here_m, middle_m, there_m)
            spot = find_free_spot(beside, first, needed, profile.mount_position_m, profile.grasp_band_m)
            if spot is not None and support is not None:
                return self._leave(answer.gone, support.name, spot)
        return self._leave()

    def on_refused(self, answer: NoPlan) -> Status:
        """Nothing is moved: the way to the place is planned next, and says what is wrong."""
        return self._leave()

    def _leave(self, objects: tuple[str, ...] = (), support: str = "", to: Vector = (0.0, 0.0, 0.0)) -> Status:
        for port, value in (("things", Names(objects)), ("support", support), ("to", to)):
            self.write(port, value)
        return self.succeed("", things=list(objects))


def list_removable(session: Session, now: Environment, name: str, destination: str) -> tuple[str, ...]:
    """What fills a destination and may be moved out for an object; last what the goal itself puts there."""
    if any("*" in text for text in (*session.hold, *session.accept)):
        return ()  # it is about every object
    found = [each for each in find_filling(now, destination) if each != name and each not in session.kept]
    return tuple(sorted(found, key=lambda each: each in session.coming))
