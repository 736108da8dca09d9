"""Functions on scalars compiled by numba, so that blocks of samples run through the code of the live tick.

The live tick calls such a function as it is. numba is imported when something is compiled, not before.
"""

import functools
import hashlib
import types
from collections.abc import Callable
from typing import Any


@functools.cache
def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function compiled by numba, together with the functions of this package that it calls by their names.

    The machine code is cached on disk (numba's ``cache=True``): beside the source, or in the user's cache directory.
    numba looks for changes in the file of the function only; the name under which the code is cached therefore
    contains a digest of the function, of what it calls, and of the constants that both refer to.
    """
    import numba

    called = {
        name: compiled(value) for name, value in _globals_of(function).items() if isinstance(value, types.FunctionType)
    }
    twin = types.FunctionType(function.__code__, function.__globals__ | called, function.__name__)
    twin.__qualname__ = f"{function.__qualname__}_{_digest(function)}"
    try:
        return numba.njit(cache=True)(twin)
    except RuntimeError:  # no directory that can be written to
        return numba.njit(twin)


def _globals_of(function: Callable[..., Any]) -> dict[str, object]:
    """The globals that a function refers to, by name."""
    known = function.__globals__
    return {name: known[name] for name in function.__code__.co_names if name in known}


def _digest(function: Callable[..., Any]) -> str:
    """Changes with the code of the function, of the functions it calls, and with their constants."""
    code = function.__code__
    text = [code.co_code.hex(), repr(code.co_consts), repr(code.co_names)]
    for name, value in _globals_of(function).items():
        if isinstance(value, types.FunctionType):
            text.append(f"{name}: {_digest(value)}")
        elif isinstance(value, type | types.ModuleType):
            text.append(f"{name}: {value.__name__} {getattr(value, '_fields', '')}")
        else:
            text.append(f"{name}: {value!r}")
    return hashlib.sha256("\n".join(text).encode()).hexdigest()[:16]
