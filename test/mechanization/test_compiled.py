"""Compiled functions: what they call is compiled too, a change is noticed; an import compiles nothing."""

import math
import subprocess
import sys
import types

import pytest

from ins_nav.mechanization.compiled import _digest, compiled
from ins_nav.mechanization.strapdown import increments

SCALE = 2.0


def _inner(x: float) -> float:
    return SCALE * math.sqrt(x)


def _outer(x: float) -> float:
    return _inner(x) + 1.0


def test_calls_are_compiled_too() -> None:
    previous, sample = (0.01, 0.1, 0.2, 0.3, 1.0, 2.0, 9.0), (0.02, 0.2, 0.1, 0.4, 2.0, 1.0, 9.5)
    for instantaneous in (True, False):
        found = compiled(increments)(previous, sample, instantaneous)
        assert found == pytest.approx(increments(previous, sample, instantaneous), rel=1e-14)
    assert compiled(increments) is compiled(increments)


def test_the_digest_changes_with_callees_and_constants() -> None:
    """numba alone would go on with the machine code of yesterday: it looks at the file of the outer function only."""

    def with_globals(**changed: object) -> types.FunctionType:
        inner = types.FunctionType(_inner.__code__, globals() | changed)
        return types.FunctionType(_outer.__code__, globals() | {"_inner": inner})

    assert _digest(with_globals()) == _digest(_outer)
    assert _digest(with_globals(SCALE=3.0)) != _digest(_outer)
    assert _digest(with_globals(math=types.ModuleType("other"))) != _digest(_outer)


def test_importing_is_free_of_numba() -> None:
    program = "import sys; import ins_nav.navigator.delayed; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
