"""Schedule of the calibration services at stops."""

from ins_nav.config.sections import StopDetectorSection

_NEVER = 2**63


class ServiceSchedule:
    """Calls ZUPT-1 until it has succeeded at two stops, and ZUPT-2 at every stop.

    A service is called when the stop has lasted for the given time; after a success again when the stop's length has
    doubled, since the sigma of residual rates falls with the length to the power 1.5; after a refusal when the given
    time has passed again (there may have been no solution yet). ZUPT-1 is not repeated at a stop where it succeeded,
    since its second position must be another one; ZUPT-2 is repeated there. Where ZUPT-1 is refused for lack of a
    turn, ZUPT-2 follows at once. The next call waits for the answer.

    Parameters
    ----------
    section : StopDetectorSection
        ``start_sequence`` is ``zupt1`` as above; ``zupt2``: ZUPT-2 from the first stop on; ``none``: no call at the
        first stop, then ZUPT-2; ``never``: no calls. ``zupt1_after`` and ``zupt2_after`` are the length of a stop at
        the first call, s.

    Attributes
    ----------
    stop : int
        Number of the present or last stop, from 1.
    due_ns : int
        Length of the present stop at which the next call is due.
    """

    def __init__(self, section: StopDetectorSection) -> None:
        self._sequence = section.start_sequence
        self._after_ns = {"zupt1": section.zupt1_after_ns, "zupt2": section.zupt2_after_ns}
        self.restart()

    def restart(self) -> None:
        """Return to the state before the first stop: the recording starts again."""
        self.stop = 0
        self.due_ns = _NEVER
        self._positions = 0
        self._service = ""
        self._again = ""
        self._next_ns = _NEVER

    def arrive(self) -> None:
        """A stop begins."""
        self.stop += 1
        self._service = "zupt1" if self._sequence == "zupt1" and self._positions < 2 else "zupt2"
        self._again = self._service
        skipped = self._sequence == "never" or (self._sequence == "none" and self.stop == 1)
        self.due_ns = _NEVER if skipped else self._after_ns[self._service]

    def take(self) -> str:
        """The service to call now; no other is due until it has answered."""
        self._next_ns, self.due_ns = self.due_ns, _NEVER
        return self._service

    def answered(self, service: str, stop: int, success: bool) -> None:
        """The service called at that stop has answered."""
        if service == "zupt1" and success:
            self._positions += 1
        if stop != self.stop:
            return
        if service == "zupt1" and not success:
            self._service, self.due_ns = "zupt2", self._next_ns
            return
        if service == "zupt1":
            self._again = "zupt2"
        later = self._next_ns if success else self._after_ns[service]
        self._service, self.due_ns = self._again, self._next_ns + later
