"""Leaves that end by themselves: after a time, or at once with a code."""

from phyagentos.runtime.execution.leaf import Leaf, PortInformation, Role, Status


class Wait(Leaf):
    """Hold still for some time."""

    ROLE = Role.WAIT
    INPUT_PORTS = {"seconds": PortInformation(data_type=float, description="How long, simulated [s].")}

    _until_s = 0.0

    def on_start(self) -> Status:
        """Begin to wait."""
        self._until_s = self.context.time_s + self.read("seconds") - 0.5 * self.context.profile.control_period_s
        return self.on_running()

    def on_running(self) -> Status:
        """Hold until time is up."""
        if self.context.time_s >= self._until_s:
            return self.on_waited()
        self.context.commands.hold()
        return Status.RUNNING

    def on_waited(self) -> Status:
        """Time is up."""
        return self.succeed()


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
