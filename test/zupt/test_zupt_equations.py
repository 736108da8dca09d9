"""ZUPT-1 and ZUPT-2 on made-up stops: exact recovery, covariances against the theoretical bound, refusals."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from ins_nav.mechanization.earth import RATE
from ins_nav.zupt.zupt_equations import (
    Calibration,
    Prior,
    StopMeasurement,
    ZuptError,
    _residual,
    after_alignment,
    rebased,
    zupt1,
    zupt1_linear,
    zupt1_nonlinear,
    zupt2,
    zupt2_update,
)

Array = np.ndarray
Solver = Callable[[StopMeasurement, StopMeasurement], Calibration]

K = RATE * math.cos(math.radians(60.0))
DRIFT = np.array([1e-7, -1e-7, 1e-7])
EXACT = np.eye(3) * 1e-20
"""Covariance of a stop without noise: sigma 1e-10 rad/s, far above rounding, so no residual is refused."""
NOISE = np.array([2e-9, 3e-9, 1e-9])
"""Sigma of the rates, rad/s: some minutes with gyros of 0.0001 °/√h; azimuth to 0.003°, so the problem is linear."""
DRAWS = 300


def _position(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> Array:
    """Body to S, from degrees."""
    return Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix()


def _stop(
    rot_sb: Array,
    azimuth: float,
    gain: float = 0.0,
    drift: Array = DRIFT,
    covariance: Array = EXACT,
    error: Array | float = 0.0,
) -> StopMeasurement:
    """What the model says: ``azimuth`` is that of S at present, ``gain`` s after the stop."""
    azimuth_gain = gain * rot_sb[2]
    then = azimuth - azimuth_gain @ drift
    rate = K * np.array([-math.sin(then), math.cos(then) - 1.0, 0.0]) + rot_sb @ drift + error
    return StopMeasurement(rot_sb, rate, covariance, K, azimuth_gain)


GEOMETRIES = {
    "90": (_position(45.0), _position(135.0)),
    "180": (_position(45.0), _position(225.0)),
    "-60, tilted": (_position(10.0, 3.0, -2.0), _position(-50.0, -4.0, 5.0)),
    "120, pitched up": (_position(45.0), _position(165.0, 40.0)),
}
geometries = pytest.mark.parametrize("positions", GEOMETRIES.values(), ids=GEOMETRIES.keys())
azimuths = pytest.mark.parametrize("azimuth_deg", [0.0, 0.2, -4.0])


@geometries
@azimuths
@pytest.mark.parametrize("gain", [0.0, 400.0])
def test_zupt1_is_exact(positions: tuple[Array, Array], azimuth_deg: float, gain: float) -> None:
    azimuth = math.radians(azimuth_deg)
    first, second = (_stop(m, azimuth, g) for m, g in zip(positions, (gain, 0.1 * gain), strict=True))
    found = zupt1(first, second)
    # Gauss-Newton converges to rounding: 1e-16 * k of rates, 1e-20 rad/s, magnified by at most 30
    np.testing.assert_allclose(found.drift, DRIFT, atol=1e-17)
    assert found.azimuth == pytest.approx(azimuth, abs=1e-13)


@geometries
@azimuths
@pytest.mark.parametrize("gain", [0.0, 400.0])
def test_linear_zupt1_is_exact_to_first_order_in_the_turn_of_s(
    positions: tuple[Array, Array], azimuth_deg: float, gain: float
) -> None:
    azimuth = math.radians(azimuth_deg)
    found = zupt1_linear(_stop(positions[0], azimuth, gain), _stop(positions[1], azimuth))
    # S turns by 400 s * 1e-7 rad/s = 4e-5 rad. Its product with sin(azimuth) <= 0.07 and k is left out: 1e-10 rad/s,
    # magnified at most threefold; without that turn nothing is left out.
    np.testing.assert_allclose(found.drift, DRIFT, atol=3.0 * 0.07 * gain * 1e-7 * K + 1e-17)
    assert found.azimuth == pytest.approx(azimuth, abs=3.0 * 0.07 * gain * 1e-7 + 1e-13)


@azimuths
@pytest.mark.parametrize("tilted", [_position(165.0, 40.0), _position(-45.0, -30.0), _position(225.0, 5.0, 45.0)])
def test_nonlinear_zupt1_is_exact_with_a_tilted_position(tilted: Array, azimuth_deg: float) -> None:
    azimuth = math.radians(azimuth_deg)
    stops = _stop(_position(45.0), azimuth), _stop(tilted, azimuth)
    blind = [StopMeasurement(s.rot_sb, s.rate + [0.0, 0.0, 1e-5], EXACT, K, s.azimuth_gain) for s in stops]
    for first, second in (stops, blind):  # a run-off of yaw that is not the drift's does not matter
        found = zupt1_nonlinear(first, second)
        # the quadratic's discriminant is a difference of numbers near 1: rounding 1e-16 k / sin²(30°), some times over
        np.testing.assert_allclose(found.drift, DRIFT, atol=1e-17)
        assert found.azimuth == pytest.approx(azimuth, abs=1e-12)


@pytest.mark.parametrize("rot_sb", [_position(45.0), _position(-120.0, 5.0, -8.0), _position(30.0, 60.0)])
def test_zupt2_is_exact(rot_sb: Array) -> None:
    np.testing.assert_allclose(zupt2(_stop(rot_sb, 0.0)).drift, DRIFT, atol=1e-20)  # rounding of one linear system


@pytest.mark.parametrize("true_deg", [0.0, 30.0, -135.0, 179.0])
def test_self_alignment_is_a_stop_in_the_same_position(true_deg: float) -> None:
    true, rot_sb = math.radians(true_deg), _position(20.0, 4.0, -3.0)  # to axes of any azimuth
    drift_s = rot_sb @ DRIFT
    b = np.array([-K * math.sin(true), K * math.cos(true), 0.0]) + drift_s  # (1), (5)
    found = math.atan2(-b[0], b[1])  # (2)
    covariance = np.diag([4.0, 9.0, 1.0]) * 1e-18
    stop = after_alignment(b, found, rot_sb, K, covariance)
    same = _stop(Rotation.from_euler("z", -found).as_matrix() @ rot_sb, true - found)
    # rounding of rates of the size of k
    np.testing.assert_allclose(stop.rate, same.rate, atol=1e-19)
    np.testing.assert_allclose(stop.rot_sb, same.rot_sb, atol=1e-15)
    assert stop.rate[0] == pytest.approx(0.0, abs=1e-19)  # the azimuth found has absorbed the east drift
    assert np.trace(stop.covariance) == pytest.approx(np.trace(covariance))
    result = zupt1(stop, _stop(_position(90.0) @ same.rot_sb, true - found))
    np.testing.assert_allclose(result.drift, DRIFT, atol=1e-17)
    improved = found + result.azimuth
    # (6), on the axes of the alignment
    assert math.sin(improved) == pytest.approx(-(b[0] - drift_s[0]) / K, abs=1e-12)
    assert math.cos(improved) == pytest.approx((b[1] - drift_s[1]) / K, abs=1e-12)


def test_zupt2_after_a_self_alignment_in_place_sees_no_east_drift_and_says_so() -> None:
    rot_sb = _position(45.0)
    east = float(rot_sb[0] @ DRIFT)
    stddev = 3e-3
    found = zupt2(_stop(rot_sb, math.asin(east / K)), stddev)
    # east is absorbed exactly; north by k (1 - cos azimuth), 1e-10 rad/s
    np.testing.assert_allclose(rot_sb @ found.drift, [0.0, *(rot_sb @ DRIFT)[1:]], atol=3e-10)
    assert rot_sb[0] @ found.covariance[:3, :3] @ rot_sb[0] == pytest.approx((K * stddev) ** 2, rel=1e-3)


@pytest.mark.parametrize("method", [zupt1, zupt1_linear, zupt1_nonlinear])
@pytest.mark.parametrize("second", [_position(45.0), _position(60.0), _position(45.0, 40.0)])
def test_positions_without_a_turn_are_refused(method: Solver, second: Array) -> None:
    with pytest.raises(ZuptError, match=r"no turn between the positions: yaw differs by (0|15)\.0°, .* turn the veh"):
        method(_stop(_position(45.0), 0.0), _stop(second, 0.0))


@pytest.mark.parametrize("method", [zupt1, zupt1_linear, zupt1_nonlinear])
def test_rocking_without_a_mean_attitude_is_refused(method: Solver) -> None:
    still, rocking = _stop(_position(45.0), 0.0), _stop(0.3 * _position(135.0), 0.0)
    for first, second in ((still, rocking), (rocking, still)):
        with pytest.raises(ZuptError, match="rocking too much"):
            method(first, second)
    with pytest.raises(ZuptError, match="rocking too much"):
        zupt2(rocking)


@pytest.mark.parametrize(
    ("method", "sentence"),
    [(zupt1, "no drift and azimuth explain both stops"), (zupt1_linear, r"sin² .* is [01]\.\d+, not 1")],
)
def test_a_drift_that_changed_is_refused(method: Solver, sentence: str) -> None:
    # after 90° four horizontal rates give three unknowns: the difference of both changes is left over, 100 sigma here
    changed = DRIFT + [3e-7, -3e-7, 0.0]
    noise = np.diag(NOISE**2)
    first = _stop(_position(0.0), 0.0, covariance=noise)
    with pytest.raises(ZuptError, match=f"inconsistent: {sentence}"):
        method(first, _stop(_position(90.0), 0.0, drift=changed, covariance=noise))


def test_nonlinear_zupt1_refuses_level_positions() -> None:
    with pytest.raises(ZuptError, match="tilt the unit by 20° or more"):
        zupt1_nonlinear(_stop(_position(45.0), 0.0), _stop(_position(135.0, 2.0), 0.0))


def test_nonlinear_zupt1_refuses_a_tilt_that_acts_as_the_azimuth() -> None:
    # here the drift that the differences do not show lies east in both positions, as an azimuth's: a double root
    with pytest.raises(ZuptError, match=r"do not separate drift and azimuth .* by another angle"):
        zupt1_nonlinear(_stop(_position(45.0), 0.0), _stop(_position(135.0, -30.0), 0.0))


def test_nonlinear_zupt1_refuses_rates_without_a_root() -> None:
    first, second = _stop(_position(0.0), 0.0), _stop(_position(90.0, 40.0), 0.0)
    moved = StopMeasurement(first.rot_sb, first.rate + 10.0 * K, EXACT, K, first.azimuth_gain)
    with pytest.raises(ZuptError, match="inconsistent: no drift makes sin²"):
        zupt1_nonlinear(moved, second)


def _band(count: int) -> tuple[float, float]:
    """Where the RMS of normal deviates lies, but for once in 1000 times."""
    low, high = stats.chi2.ppf([0.0005, 0.9995], count) / count
    return math.sqrt(low), math.sqrt(high)


def _assert_consistent(errors: Array, covariance: Array) -> None:
    """Errors, shape (n, 4), against a covariance: each by its sigma, all together by the whole."""
    low, high = _band(len(errors))
    rms = np.sqrt((errors**2).mean(axis=0) / np.diag(covariance))
    assert np.all((low < rms) & (rms < high)), rms
    low, high = _band(errors.size)
    whole = math.sqrt(np.einsum("ni,ij,nj->", errors, np.linalg.inv(covariance), errors) / errors.size)
    assert low < whole < high


def _drawn_errors(method: Solver, positions: tuple[Array, Array], azimuth: float) -> tuple[Array, Array]:
    """Errors of drifts and azimuth over draws of noise, shape (n, 4), and the covariance of one."""
    rng = np.random.default_rng(1)
    noise = np.diag(NOISE**2)
    errors = []
    for _ in range(DRAWS):
        stops = [_stop(m, azimuth, 100.0, covariance=noise, error=NOISE * rng.standard_normal(3)) for m in positions]
        try:
            found = method(*stops)
        except ZuptError as error:
            assert "inconsistent" in str(error)  # once in 1000 by design
            continue
        errors.append([*(found.drift - DRIFT), found.azimuth - azimuth])
    assert len(errors) >= DRAWS - 3  # 0.3 expected
    return np.array(errors), found.covariance


@pytest.mark.parametrize(
    ("method", "positions"),
    [
        (zupt1, GEOMETRIES["90"]),
        (zupt1, GEOMETRIES["180"]),
        (zupt1_linear, GEOMETRIES["90"]),
        (zupt1_linear, GEOMETRIES["120, pitched up"]),
        (zupt1_nonlinear, GEOMETRIES["120, pitched up"]),
    ],
)
def test_errors_of_zupt1_are_as_its_covariance_says(method: Solver, positions: tuple[Array, Array]) -> None:
    _assert_consistent(*_drawn_errors(method, positions, 1e-3))


@geometries
def test_zupt1_reaches_the_cramer_rao_bound(positions: tuple[Array, Array]) -> None:
    azimuth = 1e-3

    def rates(x: Array) -> Array:
        return np.concatenate([_stop(m, x[3], 100.0, drift=x[:3]).rate for m in positions])

    truth, steps = np.array([*DRIFT, azimuth]), np.array([1e-9, 1e-9, 1e-9, 1e-5])
    jacobian = np.column_stack([(rates(truth + d) - rates(truth - d)) / (2.0 * d.sum()) for d in np.diag(steps)])
    bound = np.linalg.inv(jacobian.T @ np.diag(np.tile(NOISE**-2, 2)) @ jacobian)
    errors, covariance = _drawn_errors(zupt1, positions, azimuth)
    # RMS of 300 draws scatters by 4 %
    assert np.all(np.sqrt((errors**2).mean(axis=0) / np.diag(bound)) <= 1.15)
    # the same matrix, the model's own error of 1e-10 rad/s added, but for the differences' truncation and the point
    # where it is taken, one sigma away
    told = np.linalg.inv(jacobian.T @ np.diag(np.tile(1.0 / (NOISE**2 + 1e-20), 2)) @ jacobian)
    scale = np.sqrt(np.diag(told))
    np.testing.assert_allclose(covariance / np.outer(scale, scale), told / np.outer(scale, scale), atol=1e-3)


def test_errors_of_zupt2_are_as_its_covariance_says() -> None:
    rng = np.random.default_rng(2)
    rot_sb, heading_stddev, noise = _position(30.0, 10.0, -5.0), 1e-4, np.diag(NOISE**2)
    errors = []
    for _ in range(DRAWS):
        azimuth = heading_stddev * rng.standard_normal()
        found = zupt2(_stop(rot_sb, azimuth, covariance=noise, error=NOISE * rng.standard_normal(3)), heading_stddev)
        errors.append([*(found.drift - DRIFT), found.azimuth - azimuth])
    _assert_consistent(np.array(errors), found.covariance)


WIDE = np.diag([1e-4**2] * 3 + [1e-20])
"""A prior that says nothing of drifts, and knows the azimuth."""
TILTED = _position(30.0, 10.0, -5.0)


@pytest.mark.parametrize("rot_sb", [_position(45.0), _position(-120.0, 5.0, -8.0), _position(30.0, 60.0)])
def test_zupt2_update_is_exact_with_a_wide_prior(rot_sb: Array) -> None:
    away = 200.0 * float(rot_sb[2] @ DRIFT)  # what yaw has run off since the start of the stop
    found, contradicted = zupt2_update(_stop(rot_sb, away, 200.0), WIDE)
    assert not contradicted
    # the prior holds back by the noise over it: 2e-20 / 1e-8, and (k 1e-10)² of the azimuth's is less
    np.testing.assert_allclose(found.drift, DRIFT, atol=1e-18)
    assert found.azimuth == pytest.approx(away, abs=1e-15)


def test_zupt2_update_corrects_what_has_run_off_before_the_stop() -> None:
    before = np.array([30.0, -50.0, 900.0])  # s, turning between
    away = float(before @ DRIFT)
    stop = _stop(TILTED, away + 200.0 * float(TILTED[2] @ DRIFT), 200.0)
    found, _ = zupt2_update(stop, WIDE, before)
    # 9e-5 rad of azimuth: its square, by k, is left out
    np.testing.assert_allclose(found.drift, DRIFT, atol=2.0 * K * away**2 + 1e-18)
    assert found.azimuth == pytest.approx(away + 200.0 * float(TILTED[2] @ DRIFT), abs=1200.0 * 2.0 * K * away**2)
    ignored, _ = zupt2_update(stop, WIDE)
    assert np.abs(ignored.drift - DRIFT).max() > 1e-9  # so that the test can fail


def test_zupt2_update_is_a_kalman_update_when_the_azimuth_is_known() -> None:
    prior = np.zeros((4, 4))
    prior[:3, :3] = np.array([[4.0, 1.0, 0.0], [1.0, 3.0, -0.5], [0.0, -0.5, 2.0]]) * 1e-14
    noise = np.array([[3.0, 1.0, 0.2], [1.0, 2.0, 0.0], [0.2, 0.0, 1.0]]) * 1e-14
    stop = _stop(TILTED, 0.0, covariance=noise)
    found, _ = zupt2_update(stop, prior)
    gain = prior[:3, :3] @ TILTED.T @ np.linalg.inv(TILTED @ prior[:3, :3] @ TILTED.T + noise)
    # the model's own error, (1e-10 rad/s)², beside 1e-14
    np.testing.assert_allclose(found.drift, gain @ stop.rate, rtol=1e-5)
    covariance = (np.eye(3) - gain @ TILTED) @ prior[:3, :3]
    np.testing.assert_allclose(found.covariance[:3, :3], covariance, atol=1e-5 * 4e-14)
    assert (found.azimuth, found.covariance[3, 3]) == (0.0, 0.0)


def test_zupt2_update_weighs_an_uncertain_azimuth_but_leaves_it() -> None:
    """An azimuth known to 1e-2 rad says little of east, and north and up are found all the same."""
    prior = np.diag([(3.0 * 1e-7) ** 2] * 3 + [1e-4])
    found, _ = zupt2_update(_stop(_position(90.0), 5e-3), prior)  # body forward is north, left is west
    assert found.azimuth == 0.0 and found.covariance[3, 3] == 1e-4
    east, north, up = _position(90.0) @ found.drift
    drift = _position(90.0) @ DRIFT
    # north is off by k (1 - cos azimuth), 5e-10 rad/s; the azimuth's share in east is 1.8e-7 rad/s, of 3.6e-7 at most
    np.testing.assert_allclose([north, up], drift[1:], atol=1e-9)
    weight = 9e-14 / (9e-14 + K**2 * 1e-4)
    assert east == pytest.approx(weight * (drift[0] - K * math.sin(5e-3)), rel=1e-4)


@pytest.mark.parametrize("sigma", [1e-8, 1e-10])
def test_a_prior_that_the_stop_contradicts_is_not_believed(sigma: float) -> None:
    prior = np.diag([sigma**2] * 3 + [1e-20])
    stop = _stop(TILTED, 0.0, covariance=np.diag(NOISE**2))
    found, contradicted = zupt2_update(stop, prior)
    assert contradicted
    # sigmas grow until the drifts are 4 of them (3 degrees of freedom, once in 1000): at least 4e-8 rad/s, which
    # beside a noise of 3e-9 rad/s holds back by 1/200 at most
    np.testing.assert_allclose(found.drift, DRIFT, rtol=6e-3)
    within, contradicted = zupt2_update(stop, np.diag([1e-14] * 3 + [1e-20]))
    assert not contradicted
    np.testing.assert_allclose(within.drift, DRIFT, rtol=2e-3)


@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_errors_of_zupt2_update_are_as_its_covariance_says(correlation: float) -> None:
    """Drifts and azimuth drawn from the prior; after a self-alignment they are correlated."""
    rng = np.random.default_rng(3)
    sigma = np.array([5e-9, 5e-9, 5e-9, 2e-4])
    prior = np.diag(sigma**2)
    prior[0, 3] = prior[3, 0] = correlation * sigma[0] * sigma[3]
    before, noise = np.array([20.0, -30.0, 600.0]), np.diag(NOISE**2)
    root, errors = np.linalg.cholesky(prior), []
    for _ in range(DRAWS):
        *drift, known = root @ rng.standard_normal(4)
        present = known + (before + 200.0 * TILTED[2]) @ drift
        stop = _stop(TILTED, present, 200.0, np.array(drift), noise, NOISE * rng.standard_normal(3))
        found, contradicted = zupt2_update(stop, prior, before)
        if not contradicted:  # once in 1000 by design
            errors.append([*(found.drift - drift), found.azimuth - present])
            covariance = found.covariance
    assert len(errors) >= DRAWS - 3
    _assert_consistent(np.array(errors), covariance)
    assert np.all(np.diag(covariance)[:3] < sigma[:3] ** 2)  # something was learnt


@pytest.mark.parametrize("turn", [0.0, 1e-3, -2.5])
@pytest.mark.parametrize("gain", [0.0, 400.0])
def test_rebased_stop_says_the_same(turn: float, gain: float) -> None:
    """Less a bias, on turned axes: the residual of any drift and azimuth, turned likewise, has the same size."""
    bias = np.array([3e-7, -2e-7, 5e-7])
    noise = np.diag(NOISE**2)
    stop = _stop(TILTED, 0.02, gain, covariance=noise, error=np.array([4e-9, -2e-9, 1e-9]))
    other = rebased(stop, bias, turn)
    axes = _position(math.degrees(turn))  # components turn the other way
    rng = np.random.default_rng(4)
    for _ in range(5):
        drift, azimuth = 1e-7 * rng.standard_normal(3), 0.1 * rng.standard_normal()
        # what S has turned since by the bias now taken out is no turn by drift any more
        new = np.array([*(drift - bias), azimuth + turn - stop.azimuth_gain @ bias])
        old, _ = _residual(np.array([*drift, azimuth]), stop, stop)
        moved, _ = _residual(new, other, other)
        np.testing.assert_allclose(moved[:3], axes @ old[:3], atol=1e-19)  # rounding of rates of the size of k
    np.testing.assert_allclose(other.rot_sb, axes @ TILTED, atol=1e-15)
    np.testing.assert_allclose(other.covariance, axes @ noise @ axes.T, atol=1e-30)


def test_zupt1_with_a_prior_is_consistent_and_better() -> None:
    rng = np.random.default_rng(5)
    sigma = np.array([4e-9, 4e-9, 4e-9, 1e-4])
    prior = Prior(np.array([1e-8, 0.0, -1e-8]), 2e-4, np.diag(sigma**-2))
    noise, positions, errors = np.diag(NOISE**2), GEOMETRIES["90"], []
    gains = 300.0, 100.0
    for _ in range(DRAWS):
        drift = prior.drift + sigma[:3] * rng.standard_normal(3)
        at_first = prior.azimuth + sigma[3] * rng.standard_normal()
        present = at_first + gains[0] * positions[0][2] @ drift
        stops = [
            _stop(m, present, g, drift, noise, NOISE * rng.standard_normal(3))
            for m, g in zip(positions, gains, strict=True)
        ]
        try:
            found = zupt1(*stops, prior)
        except ZuptError as error:
            assert "inconsistent" in str(error)  # once in 1000 by design
            continue
        errors.append([*(found.drift - drift), found.azimuth - present])
    assert len(errors) >= DRAWS - 3
    _assert_consistent(np.array(errors), found.covariance)
    alone = zupt1(*stops)
    assert np.all(np.diag(found.covariance) < np.diag(alone.covariance))


@pytest.mark.parametrize("wrong", [np.array([1e-6, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 0.05])])
def test_a_prior_that_both_stops_contradict_is_left_out(wrong: Array) -> None:
    """100 sigma off in a drift, or in the azimuth."""
    noise = np.diag(NOISE**2)
    stops = [_stop(m, 1e-3, 100.0, covariance=noise) for m in GEOMETRIES["180"]]
    prior = Prior(DRIFT + wrong[:3], 1e-3 + float(wrong[3]), np.diag([1e8**2] * 3 + [2e3**2]))
    with_prior, alone = zupt1(*stops, prior), zupt1(*stops)
    np.testing.assert_array_equal(with_prior.drift, alone.drift)
    assert with_prior.azimuth == alone.azimuth
    np.testing.assert_array_equal(with_prior.covariance, alone.covariance)


def test_a_prior_without_information_changes_nothing() -> None:
    noise = np.diag(NOISE**2)
    stops = [_stop(m, 1e-3, 100.0, covariance=noise, error=NOISE) for m in GEOMETRIES["90"]]
    with_prior, alone = zupt1(*stops, Prior(np.ones(3), 1.0, np.zeros((4, 4)))), zupt1(*stops)
    # one iteration more: rounding
    np.testing.assert_allclose(with_prior.drift, alone.drift, atol=1e-17)
    assert with_prior.azimuth == pytest.approx(alone.azimuth, abs=1e-12)


def test_sentence() -> None:
    per_hour = math.radians(1.0) / 3600.0
    sigma = np.array([1e-4 * per_hour, 2e-4 * per_hour, 3e-4 * per_hour, math.radians(0.004)])
    found = Calibration(np.array([0.02, -0.0213, 2.0]) * per_hour, math.radians(-0.25), np.diag(sigma**2))
    drifts = "gyro drifts in °/h: x +0.0200 ± 0.0001, y -0.0213 ± 0.0002, z +2.0000 ± 0.0003"
    assert found.sentence(False) == drifts
    assert found.sentence(True) == f"{drifts}; heading corrected by -0.2500° ± 0.0040°"
