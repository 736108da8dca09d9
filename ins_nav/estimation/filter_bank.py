"""The main filter, and beside it the filters that watch over it: of solution separation, and of fault hypotheses.

All have the propagation and the solution of the main filter in common; only that one corrects the solution.
"""

from dataclasses import replace

from ins_nav.estimation.error_filter import ErrorFilter
from ins_nav.estimation.error_model import Array, ErrorModel
from ins_nav.estimation.fault_hypotheses import FaultHypotheses, Verdict
from ins_nav.estimation.innovation_gate import GATE, limit
from ins_nav.estimation.observation import Measurement, Update
from ins_nav.estimation.solution_separation import ProtectionLevel, SolutionSeparation
from ins_nav.mechanization.nav_state import NavState

_REASONS = {
    Verdict.EXCLUDED: "excluded, its fault is not over",
    Verdict.FAILED: "the solution had failed",
    Verdict.RESTORED: "the source is at fault, not the solution",
    Verdict.RECOVERED: "",
}


class FilterBank:
    """The filters.

    Parameters
    ----------
    main : ErrorFilter

    Attributes
    ----------
    main : ErrorFilter
        The solution is corrected by this one: `ErrorFilter.feed_back`, then `follow`.
    separation : SolutionSeparation
    hypotheses : FaultHypotheses
    """

    def __init__(self, main: ErrorFilter) -> None:
        self.main = main
        self.separation = SolutionSeparation(main)
        self.hypotheses = FaultHypotheses(main)

    @property
    def model(self) -> ErrorModel:
        """Of the main filter."""
        return self.main.model

    @property
    def _others(self) -> list[ErrorFilter]:
        return self.separation.filters + self.hypotheses.filters

    def propagate(self, before: NavState, after: NavState, duration: float) -> None:
        """Propagate all filters; see `ErrorFilter.propagate`."""
        main = self.main
        travels = main.travels(after)
        core = main.model.transition(before, after, duration, travels)
        half = main.model.noise(before, after, 0.5 * duration)
        for each in (main, *self._others):
            each.grow(core, half, after, duration, travels)

    def disturb(self, attitude_stddev: Array, velocity_stddev: Array, position_stddev: Array) -> None:
        """Add an error to all filters; see `ErrorFilter.disturb`."""
        for each in (self.main, *self._others):
            each.disturb(attitude_stddev, velocity_stddev, position_stddev)
        self.hypotheses.unconfirm()

    def update(
        self, source: str, name: str, stamp_ns: int, measurement: Measurement, gate: float = GATE
    ) -> tuple[Update, Verdict]:
        """Process a measurement of the present state; where it is accepted, the estimate is to be fed back.

        Parameters
        ----------
        source : str
            What may be at fault: an aid, or all that is measured at stops.
        name : str
            Of the aid, or of the kind of measurement.
        stamp_ns : int
        measurement : Measurement
        gate : float
            Probability of rejecting a consistent measurement.
        """
        main, size = self.main, len(measurement.innovation)
        update = main.examine(name, stamp_ns, measurement, gate)
        if not measurement.finite:
            return update, Verdict.NONE
        greatest = limit(size, gate)
        h, r = main.design(name, measurement), update.noise_factor * measurement.r
        self.separation.begin(source, stamp_ns)
        self.separation.renew(stamp_ns)
        verdict = self.hypotheses.weigh(source, f"{name}/{size}", stamp_ns, measurement, h, r, greatest)
        if verdict is not Verdict.NONE:
            accepted = verdict.replaced and (verdict is not Verdict.RESTORED or source not in self.hypotheses.suspects)
            update = replace(update, accepted=accepted, reason=_REASONS[verdict])
        elif update.accepted:
            main.accept(update, measurement)
        if verdict.replaced:
            self.separation.reset()
        if verdict is not Verdict.EXCLUDED:
            self.separation.update(source, measurement, h, r, greatest)
        return update, verdict

    def follow(self) -> None:
        """After the main filter has fed back its estimate."""
        for each in self._others:
            each.follow(self.main.fed_back)

    def protection_level(self) -> ProtectionLevel:
        """Bounds of the errors of the solution."""
        other = self.hypotheses.other
        name = ", ".join(self.hypotheses.suspects)
        return self.separation.protection_level({} if other is None else {name: other})
