"""Errors for people, and the end of a command by a signal."""

import functools
import signal
import sys
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any

ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that ask a command to end."""
Handler = Callable[[int, FrameType | None], Any]


class InsNavError(Exception):
    """An error whose text is one line for a person: what is wrong, the offending value, what to do."""


class Interrupted(KeyboardInterrupt):
    """A signal asks the command to end.

    Parameters
    ----------
    number : int
        Of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def for_people(program: str) -> Callable[[Callable[..., int | None]], Callable[..., int]]:
    """Make a command's ``main`` end with one line on stderr and exit code 1 on `InsNavError`.

    The first of `ENDING_SIGNALS` raises `Interrupted` in it; the exit code is 128 + number of the signal, as shells
    have it. Later ones have no effect, so that the command can close its files.
    """

    def decorate(main: Callable[..., int | None]) -> Callable[..., int]:
        @functools.wraps(main)
        def run(*args: object, **kwargs: object) -> int:
            replaced = handle_signals(_interrupt_once())
            try:
                return main(*args, **kwargs) or 0
            except InsNavError as error:
                print(f"{program}: {error}", file=sys.stderr)
                return 1
            except Interrupted as interruption:
                return 128 + interruption.number
            finally:
                restore_signals(replaced)

        return run

    return decorate


def handle_signals(handler: Handler) -> dict[int, Any]:
    """Install a handler of `ENDING_SIGNALS`, except of those that are ignored (nohup).

    Returns
    -------
    dict
        Signals and the handlers they had; empty outside the main thread, which alone can handle signals.
    """
    if threading.current_thread() is not threading.main_thread():
        return {}
    replaced: dict[int, Any] = {number: signal.getsignal(number) for number in ENDING_SIGNALS}
    replaced = {number: before for number, before in replaced.items() if before is not signal.SIG_IGN}
    for number in replaced:
        signal.signal(number, handler)
    return replaced


def restore_signals(replaced: dict[int, Any]) -> None:
    """Install again what `handle_signals` replaced."""
    for number, before in replaced.items():
        signal.signal(number, before)


def _interrupt_once() -> Handler:
    interrupted = False

    def handle(number: int, _frame: FrameType | None) -> None:
        nonlocal interrupted
        if not interrupted:
            interrupted = True
            raise Interrupted(number)

    return handle
