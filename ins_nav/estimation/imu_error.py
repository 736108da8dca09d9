"""Errors of the IMU's readings as optional blocks of the error state.

A reading is the six values of a sample, angular rate and specific force. `ImuError` is one kind of error, in a file of
its own in `ins_nav.estimation.states`; `ImuErrors` are those of one filter. The readings are::

    reading = true + bias + C(true) x

with x the states of all blocks and C their columns, linear in the reading. An error of x acts like an error
``C(reading) dx`` of the biases; this determines its part in the dynamics. A block in use has as many rows as
it has components; one whose prior is zero has none.

The states in use correct samples (`ImuErrors.correction`); biases are removed after that. A considered block (Schmidt
[1]_) is not estimated: its covariance and its correlations are propagated and enter the innovation's, its row of
the gain is zero. That is for errors which the aids hardly observe.

References
----------
.. [1] S. F. Schmidt, "Application of State-Space Methods to Navigation Problems", Advances in Control Systems, 1966,
       vol. 3. Also D. Simon, "Optimal State Estimation", Wiley, 2006, 10.3.
.. [2] P. D. Groves, "Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems", 2nd edition, Artech
       House, 2013, 4.4.2: scale factor and cross-coupling errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ins_nav.config.declaration import Section, parameter
from ins_nav.estimation.slow_state import SlowState

Array = NDArray[np.float64]
READING = 6
"""Values of a reading: angular rate, then specific force, three axes each."""


@dataclass(frozen=True)
class ImuError(Section):
    """One kind of error; a subclass declares its parameters ``imu.*`` as fields, ``stddev`` among them.

    Attributes
    ----------
    block : str
        Its name in `ins_nav.estimation.state_layout.StateLayout`.
    components : tuple of str
        Names of its states.
    stddev : float
        Prior sigma of each; 0: no such error.
    estimated : bool
        Otherwise considered.
    """

    block: ClassVar[str]
    components: ClassVar[tuple[str, ...]]
    stddev: float = 0.0
    estimated: bool = False

    @property
    def state(self) -> SlowState:
        """Prior and process noise of each component: a constant, unless a subclass overrides it."""
        return SlowState(self.stddev)

    def columns(self, reading: Array) -> Array:
        """Change of the reading by a unit of each component, shape (6, k).

        Parameters
        ----------
        reading : ndarray, shape (6,)
            Angular rate, rad/s, and specific force, m/s², on the IMU's axes. Columns are linear in it.
        """
        raise NotImplementedError


def estimated(name: str, what: str) -> Any:
    """Declare the field ``estimated`` of an `ImuError` as a parameter of that name."""
    text = f"estimate and correct {what}; false: their effect is in the sigmas, they are not corrected"
    return parameter(False, text, name=name)


class ImuErrors:
    """Blocks in use, one after the other.

    Parameters
    ----------
    errors : sequence of ImuError
        Those without prior and process noise are left out.
    mounting : ndarray, shape (3, 3), optional
        From the IMU's axes to the body's; default: identity.

    Attributes
    ----------
    sizes : dict of name to int
        Of the blocks.
    size : int
    states : tuple of SlowState
        One a component.
    considered : ndarray of bool, shape (size,)
    """

    def __init__(self, errors: Sequence[ImuError] = (), mounting: Array | None = None) -> None:
        self._errors = [error for error in errors if error.state.stddev or error.state.walk]
        self._to_body: Array = np.eye(READING)
        if mounting is not None:
            self._to_body[:3, :3] = self._to_body[3:, 3:] = mounting
        self.sizes = {error.block: len(error.components) for error in self._errors}
        self.size = sum(self.sizes.values())
        self.states = tuple(error.state for error in self._errors for _ in error.components)
        self.considered = np.array([not error.estimated for error in self._errors for _ in error.components], bool)
        by_unit: Array = np.array([self.columns(unit) for unit in np.eye(READING)])
        self._matrices: Array = by_unit.transpose(2, 1, 0)
        """Of each state: matrix from a reading to its change by a unit of the state."""

    def columns(self, reading: Array) -> Array:
        """Change of a reading by a unit of each state, both on the body's axes, shape (6, size)."""
        if not self._errors:
            return np.zeros((READING, 0))
        on_imu = self._to_body.T @ reading
        columns: Array = self._to_body @ np.hstack([error.columns(on_imu) for error in self._errors])
        return columns

    def correction(self, values: Sequence[float] | Array) -> Array | None:
        """Matrix from a reading less its bias to the true reading, shape (6, 6); None where nothing changes.

        Parameters
        ----------
        values : sequence of float
            Of the states, in use.
        """
        if not np.any(values):
            return None
        matrix: Array = np.linalg.inv(np.eye(READING) + np.einsum("k,kij->ij", values, self._matrices))
        return matrix
