"""Errors for people."""

import functools
import sys
from collections.abc import Callable


class InsNavError(Exception):
    """An error whose text is one line for a person: what is wrong, the offending value, what to do."""


def for_people(program: str) -> Callable[[Callable[..., int | None]], Callable[..., int]]:
    """Make a command's ``main`` end with one line on stderr and exit code 1 on `InsNavError`, 130 on Ctrl-C."""

    def decorate(main: Callable[..., int | None]) -> Callable[..., int]:
        @functools.wraps(main)
        def run(*args: object, **kwargs: object) -> int:
            try:
                return main(*args, **kwargs) or 0
            except InsNavError as error:
                print(f"{program}: {error}", file=sys.stderr)
                return 1
            except KeyboardInterrupt:
                return 130

        return run

    return decorate
