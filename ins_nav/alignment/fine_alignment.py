"""Fine alignment: when it ends, and how long that will take."""

from ins_nav.config.sections import AlignmentSection


class FineAlignment:
    """The end of fine alignment, by the sigma of heading or by time.

    Parameters
    ----------
    alignment : AlignmentSection
    """

    def __init__(self, alignment: AlignmentSection) -> None:
        self._target = alignment.fine_heading
        self._duration = alignment.fine_duration

    def end(self, heading_stddev: float, time: float) -> str:
        """The reason why it ends, for people; empty while it goes on.

        Parameters
        ----------
        heading_stddev : float
            rad.
        time : float
            Since the first sample of alignment, s.
        """
        if heading_stddev <= self._target:
            return "its target reached"
        return f"alignment.fine_duration ({self._duration:g} s) reached" if time >= self._duration else ""

    def time_left(self, heading_stddev: float, time: float) -> float:
        """Time to its end, s, if sigma goes on falling with the power 3/2 of time; parameters as of `end`."""
        left = self._duration - time
        if self._target > 0.0:
            ratio = max(1.0, heading_stddev / self._target)
            left = min(left, time * (ratio ** (2.0 / 3.0) - 1.0))
        return max(0.0, left)
