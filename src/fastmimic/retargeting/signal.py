"""Low-pass filter and resampling of recordings to the control rate. Both use the Fourier series of one period, so that
a cycle closes in position, velocity and acceleration. A recording that is not a cycle, less its end-to-end line, counts
as half of an odd periodic signal (a sine series), which keeps value and slope at both ends."""

import numpy as np

from fastmimic.base.arrays import Array

_FILTER_ORDER = 4


def resample_periodic(samples: Array, rate_hz: float, n_out: int, cutoff_hz: float) -> Array:
    """Low-passed samples (n_out, ...) of one period on a new grid, evenly over the period, from (n, ...) at times i /
    rate_hz. `cutoff_hz` is the half-power frequency of the zero-phase filter (Butterworth, fourth order, forwards and
    backwards)."""
    n = len(samples)
    spectrum = np.fft.rfft(samples, axis=0)
    frequency = np.fft.rfftfreq(n, 1.0 / rate_hz)
    gain = 1.0 / (1.0 + (frequency / cutoff_hz) ** (2 * _FILTER_ORDER))
    if n % 2 == 0:
        gain[-1] = 0.0  # the phase of the Nyquist component is unknown
    spectrum = spectrum * gain.reshape(-1, *[1] * (samples.ndim - 1))
    return np.fft.irfft(spectrum[: n_out // 2 + 1], n=n_out, axis=0) * (n_out / n)


def resample_open(samples: Array, rate_hz: float, n_out: int, cutoff_hz: float) -> Array:
    """Like `resample_periodic` for a recording that is not a cycle: n frames cover (n − 1) / rate_hz."""
    n = len(samples)
    shape = (-1, *[1] * (samples.ndim - 1))
    line = samples[0] + (samples[-1] - samples[0]) * (np.arange(n) / (n - 1)).reshape(shape)
    rest = samples - line
    odd = np.concatenate([rest, -rest[-2:0:-1]])
    smooth = resample_periodic(odd, rate_hz, 2 * n_out, cutoff_hz)[:n_out]
    return smooth + samples[0] + (samples[-1] - samples[0]) * (np.arange(n_out) / n_out).reshape(shape)


def extrapolate_next(samples: Array) -> Array:
    """The frame after the last one of a cycle: its step is the mean of the steps before and after the seam."""
    return samples[-1] + 0.5 * ((samples[-1] - samples[-2]) + (samples[1] - samples[0]))


def closing_error(samples: Array) -> Array:
    """Difference (...) between the frame after the last one of (n, ...) and frame 0."""
    return extrapolate_next(samples) - samples[0]
