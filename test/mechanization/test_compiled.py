"""Compiled functions: what they call is compiled too, a change is noticed; an import compiles nothing."""

import math
import subprocess
import sys
import types
from typing import Any

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


def test_without_a_place_for_the_cache() -> None:
    """A function of no file cannot be cached, as where no directory can be written to: compiled all the same."""
    known: dict[str, Any] = {}
    exec(compile("def double(x):\n    return 2.0 * x", "nowhere", "exec"), known)
    assert compiled(known["double"])(3.0) == 6.0


def test_a_second_process_compiles_nothing() -> None:
    """What `prepare` compiles is there for the next process, signature and all."""
    program = """
from ins_nav.mechanization import strapdown
from ins_nav.mechanization.compiled import compiled
strapdown.prepare()
assert len(compiled(strapdown._fill_states).signatures) == 2
print(sum(compiled(strapdown._fill_states).stats.cache_misses.values()))
strapdown.integrate(strapdown.NavState(*[1.0] * 12), (0.01, *[0.0] * 6), strapdown.np.ones((2, 7)))
assert len(compiled(strapdown._fill_states).signatures) == 2
"""
    command = [sys.executable, "-c", program]
    subprocess.run(command, check=True)
    assert subprocess.run(command, check=True, capture_output=True, text=True).stdout == "0\n"


def test_importing_is_free_of_numba() -> None:
    program = "import sys; import ins_nav.navigator.delayed; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
