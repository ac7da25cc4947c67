"""Leaves that ask for ways to take hold of an object, to put it somewhere, and what has to go from there before."""

from phyagentos.geometry import Vector
from phyagentos.protocol.sessions.session import Session
from phyagentos.protocol.world.environment import Environment
from phyagentos.protocol.world.free_spot import find_filling, find_free_spot, find_support
from phyagentos.protocol.world.mechanisms import find_hinge
from phyagentos.runtime.execution.leaf import PortInformation, Role, Status
from phyagentos.runtime.execution.planning import BESIDE, ApproachPlanningLeaf, CandidatePlanningLeaf, PlanningLeaf
from phyagentos.runtime.execution.tree_check import Names
from phyagentos.runtime.motion.requests import (
    Approaches,
    Destination,
    FindGrasps,
    FindPlacements,
    MotionRequest,
    NoPlan,
    Payload,
)
from phyagentos.runtime.perception.world_model import BELIEF

LEVEL_SINE = 0.1  # of a hinge with the horizontal


class PlanGrasp(CandidatePlanningLeaf):
    """Approaches onto the object, if any those from which it can be put where it goes then.

    Those named in the strategy's `avoid_grasps` are left out. With `sides`, those from which it can be put down turned:
    with the first of these sides up that one grasp can bring up.
    """

    ROLE = Role.PLAN_GRASP
    INPUT_PORTS = {
        "object": PortInformation(data_type=str, description="Name of the entity to take hold of."),
        "hinged": PortInformation(
            data_type=str, required=False, description="What the handle belongs to: a level hinge turns in the fingers."
        ),
        "destination": PortInformation(
            data_type=str, required=False, description="Entity or region where it goes then; as at `plan_place`."
        ),
        "relation": PortInformation(data_type=str, default_value="inside", description="`inside` or `on`."),
        "near": PortInformation(
            data_type=tuple, required=False, description="Point to stay close to, world frame [m]."
        ),
        "sides": PortInformation(
            data_type=tuple, default_value=(), description="Directions in its frame, one of which shall point up then."
        ),
        "hover_m": PortInformation(data_type=float, default_value=0.08, description="Length of the approach [m]."),
        "beside": BESIDE,
    }
    OUTPUT_PORTS = {
        "approaches": PortInformation(data_type=Approaches, description="Checked ways, nearest first."),
        "up": PortInformation(data_type=tuple, required=False, description="The side that points up then."),
    }

    def count_candidates(self) -> int:
        """Number of sides."""
        return len(self.read("sides")) or 1

    def compose(self) -> MotionRequest | Status:
        """One request for each side."""
        whole = self.context.world.observe(BELIEF).entities.get(self.find("hinged") or "")
        axis = find_hinge(whole) if whole is not None else None
        destination, near = self.find("destination"), self.find("near")
        point = None if near is None else (float(near[0]), float(near[1]), float(near[2]))
        return FindGrasps(
            world=self.world(),
            object=self.read("object"),
            q_rad=self.context.commands.q_rad,
            seed=self.context.draw_seed(self.path),
            avoid=self.context.session.strategy.avoid_grasps,
            hover_m=self.read("hover_m"),
            along=(axis[0], axis[1], axis[2]) if axis is not None and abs(axis[2]) < LEVEL_SINE else None,
            then=None
            if destination is None
            else Destination(destination, self.read("relation"), point, self._get_up()),
        )

    def on_found(self, answer: Approaches) -> Status:
        """Write the approaches, name the labels."""
        self.write("approaches", answer)
        if (up := self._get_up()) is not None:
            self.write("up", up)
        return self.succeed("", labels=[approach.label for approach in answer.approaches])

    def _get_up(self) -> tuple[float, float, float] | None:
        return tuple(self.read("sides")[self.tried]) if self.read("sides") else None


class PlanRoom(PlanningLeaf[Approaches]):
    """The fewest things to move away, and where to; none where there is room, or where moving gives none."""

    ROLE = Role.PLAN_ROOM
    INPUT_PORTS = {port: PlanGrasp.INPUT_PORTS[port] for port in ("object", "destination", "relation", "near")}
    OUTPUT_PORTS = {
        "things": PortInformation(data_type=Names, description="What has to go, the first one first."),
        "support": PortInformation(data_type=str, description="Entity to put them on."),
        "to": PortInformation(data_type=tuple, description="Where about, world frame [m]."),
    }

    def compose(self) -> MotionRequest | Status:
        """One request, where the destination holds anything that may be moved."""
        now, name, near = self.context.world.observe(BELIEF), self.read("object"), self.find("near")
        point = None if near is None else (float(near[0]), float(near[1]), float(near[2]))
        then = Destination(self.read("destination"), self.read("relation"), point)
        if not (things := list_removable(self.context.session, now, name, then.name)):
            return self._leave()
        q_rad, seed = self.context.commands.q_rad, self.context.draw_seed(self.path)
        return FindGrasps(self.world(), q_rad, seed, name, count=1, then=then, removable=things)

    def on_answer(self, answer: Approaches) -> Status:
        """Write what has to go."""
        now, profile, place = self.context.world.observe(BELIEF), self.context.profile, self.read("destination")
        here_m = now.entities[self.read("object")].pose.position_m
        there_m = (now.regions.get(place) or now.entities[place]).pose.position_m
        middle_m = ((here_m[0] + there_m[0]) / 2, (here_m[1] + there_m[1]) / 2, here_m[2])
        for first in answer.gone[:1]:
            support, needed = find_support(now, first), (here_m, middle_m, there_m)
            spot = find_free_spot(now, first, needed, profile.mount_position_m, profile.grasp_band_m)
            if spot is not None and support is not None:
                return self._leave(answer.gone, support.name, spot)
        return self._leave()

    def on_refused(self, answer: NoPlan) -> Status:
        """Nothing is moved: the way to the place is planned next, and says what is wrong."""
        return self._leave()

    def _leave(self, things: tuple[str, ...] = (), support: str = "", to: Vector = (0.0, 0.0, 0.0)) -> Status:
        for port, value in (("things", Names(things)), ("support", support), ("to", to)):
            self.write(port, value)
        return self.succeed("", things=list(things))


def list_removable(session: Session, now: Environment, name: str, destination: str) -> tuple[str, ...]:
    """What fills a destination and may be moved out for a thing; last what the goal itself puts there."""
    if any("*" in text for text in (*session.hold, *session.accept)):
        return ()  # it is about every thing
    found = [each for each in find_filling(now, destination) if each != name and each not in session.kept]
    return tuple(sorted(found, key=lambda each: each in session.coming))


class PlanPlace(ApproachPlanningLeaf):
    """Approaches with the payload to free sites; those named in the strategy's `avoid_sites` are left out."""

    ROLE = Role.PLAN_SITE
    INPUT_PORTS = {
        "payload": PortInformation(data_type=Payload, description="What is held, and how."),
        "destination": PortInformation(data_type=str, description="Entity or region to put it into or onto."),
        "relation": PortInformation(data_type=str, default_value="inside", description="`inside` or `on`."),
        "near": PortInformation(
            data_type=tuple, required=False, description="Point to stay close to, world frame [m]."
        ),
        "near_radius_m": PortInformation(data_type=float, default_value=0.12, description="How close [m]."),
        "up": PortInformation(data_type=tuple, required=False, description="Direction in its frame to point up."),
        "hover_m": PortInformation(data_type=float, default_value=0.07, description="Length of the approach [m]."),
        "may_fall": PortInformation(
            data_type=bool, default_value=True, description="Whether it may be let go above a walled floor."
        ),
    }

    def compose(self) -> MotionRequest | Status:
        """One request."""
        near, payload, place = self.find("near"), self.read("payload"), self.read("destination")
        now = self.context.world.observe(BELIEF)
        return FindPlacements(
            world=self.world(),
            payload=payload,
            destination=place,
            relation=self.read("relation"),
            q_rad=self.context.commands.q_rad,
            seed=self.context.draw_seed(self.path),
            near=None if near is None else (float(near[0]), float(near[1]), float(near[2])),
            near_radius_m=self.read("near_radius_m"),
            up=self.find("up"),
            avoid=self.context.session.strategy.avoid_sites,
            hover_m=self.read("hover_m"),
            may_fall=self.read("may_fall"),
            coming=self.context.session.coming,
            removable=list_removable(self.context.session, now, payload.entity, place),
        )
