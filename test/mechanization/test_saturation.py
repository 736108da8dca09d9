"""A clipped axis is found at any level; quantization, peaks and rest are not."""

import numpy as np
import pytest

from ins_nav.mechanization.saturation import saturation

TIME = np.arange(100) * 0.01


def _shaking(seed: int, resolution: float = 0.0) -> np.ndarray:
    values = 3.0 * np.sin(9.0 * TIME + seed) + 0.5 * np.random.default_rng(seed).standard_normal(len(TIME))
    return np.rint(values / resolution) * resolution if resolution else values


@pytest.mark.parametrize("resolution", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("limit", [1.0, 2.0, 2.8])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_clipped_axis(limit: float, sign: float, resolution: float) -> None:
    values = sign * np.minimum(_shaking(1, resolution), limit)
    found = saturation(values)
    assert found is not None
    assert found.limit == pytest.approx(sign * limit)
    # what was cut off, in the sum over the samples, is of the size of the sigma
    cut = (_shaking(1, resolution) - np.minimum(_shaking(1, resolution), limit)).sum()
    assert cut < 3.0 * found.error < 100.0 * cut


@pytest.mark.parametrize("resolution", [0.0, 0.01, 0.1, 0.5, 1.0, 3.0, 10.0])
def test_false_alarms(resolution: float) -> None:
    """Noise and motion in 600 windows a resolution: 1e-9 a window is stated."""
    rng = np.random.default_rng(0)
    for seed in range(200):
        noise = rng.standard_normal(len(TIME))
        slow = 3.0 * np.sin(4.0 * TIME + seed)
        for values in (_shaking(seed), noise, slow):
            quantized = np.rint(values / resolution) * resolution if resolution else values
            assert saturation(quantized) is None
