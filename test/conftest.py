"""Loaded before the tests import numpy: `ins_nav` limits BLAS to one thread, which numpy asks once."""

import ins_nav  # noqa: F401
