"""Signals that wait until a file is in a state in which it can be closed."""

import signal
from types import FrameType
from typing import Any

from ins_nav.errors import Interrupted, handle_signals, restore_signals


class DeferredSignals:
    """`ENDING_SIGNALS` between `begin` and `end`: the first of them waits until `deliver` is called."""

    def __init__(self) -> None:
        self._replaced: dict[int, Any] = {}
        self._waiting: int | None = None

    def begin(self) -> None:
        """Defer signals from here on."""
        self._replaced = handle_signals(self._defer)

    def deliver(self) -> None:
        """Pass a waiting signal to its previous handler.

        Raises
        ------
        Interrupted
            There is none: the default would end the process at once.
        """
        if self._waiting is None:
            return
        number, self._waiting = self._waiting, None
        handler = self._replaced[number]
        if not callable(handler):
            raise Interrupted(number)
        handler(number, None)

    def end(self) -> None:
        """End deferral; a waiting signal takes effect now."""
        restore_signals(self._replaced)
        if self._waiting is not None:
            signal.raise_signal(self._waiting)

    def _defer(self, number: int, _frame: FrameType | None) -> None:
        if self._waiting is None:
            self._waiting = number
