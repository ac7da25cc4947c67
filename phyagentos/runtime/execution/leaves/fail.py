"""Fail on purpose, with a code: the last child of a fallback that has run out of ways."""

from phyagentos.runtime.execution.leaf import Leaf, PortInformation, Role, Status


class Fail(Leaf):
    """Always fails."""

    ROLE = Role.DECIDE
    INPUT_PORTS = {
        "code": PortInformation(data_type=str, description="Coded reason, upper case."),
        "message": PortInformation(data_type=str, default_value="no way is left", description="One sentence."),
    }

    def on_start(self) -> Status:
        """Fail."""
        return self.fail(self.read("code"), self.read("message"))
