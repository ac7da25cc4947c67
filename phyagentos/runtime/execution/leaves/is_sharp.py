"""Whether an object was seen so well that a nearer look would show no more."""

from phyagentos.runtime.execution.leaf import FailureCode, Leaf, PortInformation, Role, Status
from phyagentos.runtime.execution.leaves.locate import get_visible

POSITION_STD_M, TILT_STD_RAD = 0.002, 0.04  # predicates decide within twice these


class IsWellLocalized(Leaf):
    """Succeeds where the belief shows the object surely, and its place and tilt to 2 mm and 2 degrees."""

    ROLE = Role.DECIDE
    INPUT_PORTS = {"object": PortInformation(data_type=str, description="Name of the entity.")}

    def on_start(self) -> Status:
        """Compare the stated uncertainties."""
        seen = get_visible(self)
        tilt_rad = max(seen.turn_std_rad, seen.tilt_std_rad)
        if not seen.is_unsure and seen.position_std_m <= POSITION_STD_M and tilt_rad <= TILT_STD_RAD:
            return self.succeed()
        uncertainties = (
            f"within {1e3 * seen.position_std_m:.1f} mm and {tilt_rad:.3f} rad, confidence {seen.confidence:.2f}"
        )
        return self.fail(FailureCode.UNMET, f"{seen.name} is known {uncertainties}")
