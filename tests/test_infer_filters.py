"""Filters of tracks, and jitter."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("cv2", reason="OpenCV is not installed")

from dronepose.infer import Track, jitter, noise, one_euro, rts
from dronepose.infer.filters import exp, log

RATE = 30.0
SIGMA = (0.01, np.radians(2.0))


def flight(n=150, sigma=(0.0, 0.0), seed=0):
    """A curve with turns, and noise of each frame."""
    rng = np.random.default_rng(seed)
    s = np.arange(n) / RATE
    t = np.stack([0.5 * np.sin(s), 0.2 * np.cos(1.3 * s), 1.5 + 0.3 * np.sin(0.7 * s)], axis=1)
    vectors = np.stack([0.8 * np.sin(0.9 * s), 0.5 * np.cos(s), 1.2 * s], axis=1)
    R = Rotation.from_rotvec(vectors)
    R = Rotation.from_rotvec(sigma[1] * rng.normal(size=(n, 3))) * R
    return Track(R.as_matrix(), t + sigma[0] * rng.normal(size=(n, 3)))


def errors(track, truth):
    """Root mean square of the position, metres, and of the angle, radians."""
    angles = Rotation.from_matrix(track.R @ truth.R.swapaxes(1, 2)).magnitude()
    return np.sqrt([np.mean((track.t - truth.t) ** 2 * 3), np.mean(angles**2)])


def test_logarithm_and_exponential():
    rng = np.random.default_rng(1)
    for vector in rng.normal(size=(50, 3)):
        R = Rotation.from_rotvec(vector).as_matrix()
        np.testing.assert_allclose(exp(vector), R, atol=1e-12)
        np.testing.assert_allclose(exp(log(R)), R, atol=1e-9)
    np.testing.assert_array_equal(log(np.eye(3)), 0)


@pytest.mark.parametrize("smooth", ["one-euro", "rts"])
class TestBoth:
    def apply(self, smooth, R, t):
        return one_euro(R, t, RATE) if smooth == "one-euro" else rts(R, t, RATE)

    def test_rotations_stay_rotations(self, smooth):
        R = self.apply(smooth, *flight(sigma=SIGMA)).R
        np.testing.assert_allclose(R @ R.swapaxes(1, 2), np.eye(3)[None].repeat(150, 0), atol=1e-9)

    def test_noise_and_jitter_fall(self, smooth):
        noisy = flight(sigma=SIGMA)
        found = self.apply(smooth, *noisy)
        shaking, calm = jitter(*noisy), jitter(*found)
        assert calm[0] < 0.35 * shaking[0]
        assert calm[1] < (0.45 if smooth == "one-euro" else 0.35) * shaking[1]

    def test_what_stands_still_stays(self, smooth):
        track = Track(np.eye(3)[None].repeat(20, 0), np.tile([0.1, 0.2, 1.0], (20, 1)))
        found = self.apply(smooth, *track)
        np.testing.assert_allclose(found.t, track.t, atol=1e-9)
        np.testing.assert_allclose(found.R, track.R, atol=1e-9)

    def test_it_does_not_depend_on_the_frame(self, smooth):
        """Another camera that turns the world: the same filter, turned."""
        noisy = flight(60, sigma=SIGMA)
        Q = Rotation.from_rotvec([0.4, -1.0, 2.0]).as_matrix()
        turned = self.apply(smooth, Q @ noisy.R, noisy.t @ Q.T)
        found = self.apply(smooth, *noisy)
        np.testing.assert_allclose(turned.t, found.t @ Q.T, atol=1e-9)
        np.testing.assert_allclose(turned.R, Q @ found.R, atol=1e-8)

    @pytest.mark.parametrize("n", [0, 1, 2])
    def test_short_tracks(self, smooth, n):
        track = flight(4)
        found = self.apply(smooth, track.R[:n], track.t[:n])
        assert found.t.shape == (n, 3)
        assert np.isfinite(found.R).all()

    def test_wrong_values(self, smooth):
        R, t = flight(5)
        with pytest.raises(ValueError, match=r"^t\[2\]"):
            self.apply(smooth, R, np.where(np.arange(5)[:, None] == 2, np.nan, t))
        with pytest.raises(ValueError, match=r"^t: expected 5 rows"):
            self.apply(smooth, R, t[:3])


def test_one_euro_looks_back_only():
    noisy = flight(60, sigma=SIGMA)
    found = one_euro(*noisy, RATE)
    part = one_euro(noisy.R[:31], noisy.t[:31], RATE)
    np.testing.assert_array_equal(found.t[:31], part.t)
    np.testing.assert_array_equal(found.R[:31], part.R)


def test_one_euro_step_by_step():
    """Casiez et al. 2012, algorithm 1, for a motion along x."""
    x = np.array([0.0, 0.1, 0.15, 0.4])
    t = np.stack([x, np.zeros(4), np.ones(4)], axis=1)
    found = one_euro(np.eye(3)[None].repeat(4, 0), t, RATE, min_cutoff=1.5, beta=0.7).t[:, 0]
    alpha = lambda cutoff: 1 / (1 + RATE / (2 * np.pi * cutoff))  # noqa: E731
    last, speed, expected = 0.0, 0.0, [0.0]
    for value in x[1:]:
        speed = alpha(1.0) * (value - last) * RATE + (1 - alpha(1.0)) * speed
        a = alpha(1.5 + 0.7 * abs(speed))
        last = a * value + (1 - a) * last
        expected.append(last)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_faster_motion_lags_less_with_beta():
    t = np.stack([np.arange(60) / RATE, np.zeros(60), np.ones(60)], axis=1)
    R = np.eye(3)[None].repeat(60, 0)
    lags = [t[-1, 0] - one_euro(R, t, RATE, beta=beta).t[-1, 0] for beta in (0.0, 2.0, 20.0)]
    assert lags[0] > 2 * lags[1] > 4 * lags[2] > 0


def test_rts_halves_the_error():
    truth, noisy = flight(), flight(sigma=SIGMA)
    before, after = errors(noisy, truth), errors(rts(*noisy, RATE), truth)
    assert (after < 0.6 * before).all(), (before, after)


def test_rts_is_the_least_squares_of_its_model():
    """Along x: the maximum of the posterior, solved at once instead of forward and back."""
    rng = np.random.default_rng(4)
    n, dt, sigma, acceleration = 12, 1 / RATE, 0.02, 2.0
    x = np.cumsum(rng.normal(size=n)) * 0.02
    t = np.stack([x, np.zeros(n), np.ones(n)], axis=1)
    found = rts(np.eye(3)[None].repeat(n, 0), t, RATE,
                measurement=(sigma, 0.1), acceleration=(acceleration, 1.0)).t[:, 0]  # fmt: skip
    # Unknown: position and velocity at the start, and one acceleration a frame.
    step = np.zeros((n, n + 1))
    for k in range(n):
        step[k, 0], step[k, 1] = 1.0, k * dt
        for j in range(k):
            step[k, 2 + j] = dt * dt * (k - j - 0.5)
    prior = np.r_[sigma, 10 * acceleration * dt + sigma / dt, np.full(n - 1, acceleration)]
    # The first measurement is the prior of the position.
    A = np.vstack([np.diag(1 / prior), step[1:] / sigma])
    b = np.r_[x[0] / prior[0], np.zeros(n), x[1:] / sigma]
    expected = step @ np.linalg.lstsq(A, b, rcond=None)[0]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_one_blunder_does_not_bend_the_track():
    truth, noisy = flight(), flight(sigma=SIGMA)
    bad = Track(noisy.R.copy(), noisy.t.copy())
    bad.t[70] += [1.0, 1.0, 0.0]
    bad.R[70] = bad.R[70] @ np.diag([-1.0, -1.0, 1.0])
    found = rts(*bad, RATE)
    assert np.linalg.norm(found.t[70] - truth.t[70]) < 0.05
    turned = Rotation.from_matrix(found.R[70] @ truth.R[70].T).magnitude()
    assert np.degrees(turned) < 12.0


def test_a_track_that_jumps_is_followed():
    """A cut in the video: away from it, both parts are as smooth as ever."""
    truth, noisy = flight(), flight(sigma=SIGMA)
    moved = np.r_[np.zeros(75), np.ones(75)][:, None] * [0.8, -0.5, 1.0]
    half = np.diag([-1.0, 1.0, -1.0])
    turns = np.where(np.arange(150)[:, None, None] < 75, np.eye(3), half)
    truth = Track(turns @ truth.R, truth.t + moved)
    found = rts(turns @ noisy.R, noisy.t + moved, RATE)
    for part in (np.s_[:70], np.s_[85:]):
        after = errors(Track(*(v[part] for v in found)), Track(*(v[part] for v in truth)))
        assert (after < [0.02, np.radians(4.0)]).all(), after


def test_a_blunder_at_the_start_is_left_behind():
    truth, noisy = flight(), flight(sigma=SIGMA)
    noisy.t[0] += 2.0
    noisy.R[0] = np.diag([-1.0, -1.0, 1.0]) @ noisy.R[0]
    found = rts(*noisy, RATE)
    after = errors(Track(found.R[12:], found.t[12:]), Track(truth.R[12:], truth.t[12:]))
    assert (after < [0.02, np.radians(4.0)]).all(), after


def test_the_noise_is_found():
    found = noise(*flight(600, sigma=SIGMA))
    np.testing.assert_allclose(found, SIGMA, rtol=0.12)


def test_jitter_of_known_tracks():
    turn = np.radians(3.0)
    steady = Rotation.from_rotvec(np.outer(np.arange(10), [0.0, 0.0, turn])).as_matrix()
    line = np.outer(np.arange(10), [0.1, 0.2, 0.3])
    np.testing.assert_allclose(jitter(steady, line), 0, atol=1e-9)
    shaking = steady.copy()
    shaking[1::2] = Rotation.from_rotvec([turn, 0, 0]).as_matrix() @ np.eye(3)
    shaking[::2] = np.eye(3)
    zigzag = np.zeros((10, 3))
    zigzag[1::2, 0] = 0.01
    np.testing.assert_allclose(jitter(shaking, zigzag), [0.02, 6.0], atol=1e-9)
    assert jitter(steady[:2], line[:2]) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("options", "name"),
    [({"rate": 0.0}, "rate"), ({"min_cutoff": -1.0}, "min_cutoff"), ({"beta": np.nan}, "beta")],
)
def test_wrong_arguments(options, name):
    with pytest.raises(ValueError, match=f"^{name}: "):
        one_euro(*flight(5), **{"rate": RATE, **options})
