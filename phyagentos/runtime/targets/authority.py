"""Which session may command a target: one at a time, under an epoch that never decreases.

It decides by what the target itself has received, so that a stale sender is refused without any other process.
"""

from phyagentos.runtime.targets.wire import Command, Refused


class Authority:
    """The target's own record of claims; `session` may command, empty when none may."""

    def __init__(self) -> None:
        self.session = ""
        self._epoch = 0
        self._sequence = 0
        self._floors: dict[str, int] = {}  # of sessions that have ended: the least epoch that is still granted
        self._stopped = ""

    def check_begin(self, session: str, epoch: int) -> Refused | None:
        """Whether authority may be granted."""
        if not session:
            return Refused("MALFORMED", "a session needs a name")
        if self.session and (session, epoch) != (self.session, self._epoch):
            return Refused("NO_AUTHORITY", f"{self.session} has authority; it must end first")
        if epoch < (floor := self._floors.get(session, 0)):
            return Refused("STALE_TOKEN", f"epoch {epoch} of {session} is over; {floor} is the least that is granted")
        return None

    def begin(self, session: str, epoch: int) -> None:
        """Grant authority, once `check_begin` has nothing against it."""
        if (session, epoch) != (self.session, self._epoch):
            self._stopped = ""  # the same claim made twice does not undo a stop
        self.session, self._epoch, self._sequence = session, epoch, 0

    def check(self, session: str, epoch: int) -> Refused | None:
        """Whether a request of this session may be carried out."""
        if not self.session:
            return Refused("NO_AUTHORITY", f"{session} has no authority; no session has")
        if session != self.session:
            return Refused("NO_AUTHORITY", f"{self.session} has authority, not {session}")
        if epoch != self._epoch:
            return Refused("STALE_TOKEN", f"epoch {epoch}; authority was given for {self._epoch}")
        return None

    def check_commanding(self, session: str, epoch: int) -> Refused | None:
        """As `check`, and that no stop ended the session's commands."""
        refused = self.check(session, epoch)
        if refused is None and self._stopped:
            refused = Refused(self._stopped, f"{session} was stopped; another session must begin first")
        return refused

    def check_command(self, command: Command, time_s: float, n_before: int = 0) -> Refused | None:
        """Whether a command may be carried out at this moment [s], or after `n_before` others."""
        refused = self.check_commanding(command.session, command.epoch)
        if refused is not None:
            return refused
        if command.sequence != self._sequence + n_before + 1:
            return Refused("NO_AUTHORITY", f"number {command.sequence} after {self._sequence + n_before}")
        if not time_s <= command.expires_at_s:  # also when the expiry is NaN
            return Refused("EXPIRED", f"it is {time_s:.3f} s, the command expired at {command.expires_at_s:.3f} s")
        return None

    def count(self) -> None:
        """A command was carried out; the next one has the next sequence number."""
        self._sequence += 1

    @property
    def stopped(self) -> str:
        """Code of the stop that ended the commands of the present session, empty when none did."""
        return self._stopped if self.session else ""

    def stop(self, code: str) -> None:
        """Accept no further command of the present session; it can still be halted, observed and ended."""
        self._stopped = code

    def end(self) -> None:
        """Take authority back; the same claim is never granted again."""
        if self.session:
            self._floors[self.session] = self._epoch + 1
        self.session = ""
