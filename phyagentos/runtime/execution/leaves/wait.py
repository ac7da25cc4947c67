"""Let simulated time go by."""

from phyagentos.runtime.execution.leaf import Leaf, Port, Role, Status


class Wait(Leaf):
    """Hold still for some time."""

    ROLE = Role.WAIT
    INPUT_PORTS = {
        "seconds": Port(data_type=float, minimum=0.0, maximum=3600.0, description="How long, simulated [s].")
    }

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
