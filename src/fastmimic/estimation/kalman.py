"""The linear Kalman filter on base position, base velocity and the four feet (Bloesch et al. 2012; Bledt et al. 2018).

With known orientation and isotropic noise, the world's axes do not mix: each has its own state (p, v, f₁ … f₄), and x
and y share their covariance. So 18 states come down to two 6 × 6 covariances, and all measurements are scalars,
absorbed one after the other without any matrix inversion.

    p⁺ = p + v δt + ½ a δt²,  v⁺ = v + a δt,  fᵢ⁺ = fᵢ + uᵢ δt
    fᵢ − p = R pᵢ(q),   v = uᵢ − R (Jᵢ q̇ + ω × pᵢ(q)),   fᵢ,z = r   for feet on the ground

where a = R f̃ + g is the IMU's, and uᵢ the velocity of the sphere's centre as it rolls over its contact point. A foot
in the air is only its kinematics, fᵢ = p + R pᵢ(q): it is anchored again at each step until it stands.
"""

from fastmimic.base.arrays import Array
from fastmimic.base.jit import inlined

STATES = 6  # p, v and four feet


@inlined
def predict(mean: Array, cov: Array, accel: Array, roll: Array, accel_var: float, foot_var: float, dt: float) -> None:
    """Advances `mean` (3, 6) by axis, and `cov` (2, 6, 6) of x and y and of z, by one control step, in place. `accel`
    (3,) is the base's, world, m/s²; its variance `accel_var`, m²/s⁴, is constant within a step. `roll` (4, 3) are the
    velocities of the feet's centres in rolling, world, m/s. `foot_var`, m², is added to a foot's variance."""
    for axis in range(3):
        mean[axis, 0] += dt * (mean[axis, 1] + 0.5 * dt * accel[axis])
        mean[axis, 1] += dt * accel[axis]
        for leg in range(4):
            mean[axis, 2 + leg] += dt * roll[leg, axis]
    for c in range(2):
        for j in range(STATES):
            cov[c, 0, j] += dt * cov[c, 1, j]
        for j in range(STATES):
            cov[c, j, 0] += dt * cov[c, j, 1]
        cov[c, 0, 0] += 0.25 * dt**4 * accel_var
        cov[c, 0, 1] += 0.5 * dt**3 * accel_var
        cov[c, 1, 0] += 0.5 * dt**3 * accel_var
        cov[c, 1, 1] += dt**2 * accel_var
        for leg in range(4):
            cov[c, 2 + leg, 2 + leg] += foot_var


@inlined
def anchor(mean: Array, cov: Array, leg: int, foot: Array, var: float) -> None:
    """Puts a foot where kinematics sees it, with `foot` (3,) relative to the base, world, m; its past is forgotten."""
    f = 2 + leg
    for axis in range(3):
        mean[axis, f] = mean[axis, 0] + foot[axis]
    for c in range(2):
        for j in range(STATES):
            if j != f:
                cov[c, f, j] = cov[c, 0, j]
                cov[c, j, f] = cov[c, j, 0]
        cov[c, f, f] = cov[c, 0, 0] + var


@inlined
def _absorb(mean: Array, cov: Array, first: int, last: int, residual: Array, gain: Array, s: float) -> None:
    """Absorbs a scalar measurement along the axes first … last − 1; `gain` (6,) holds P Hᵀ."""
    for axis in range(first, last):
        for j in range(STATES):
            mean[axis, j] += gain[j] / s * residual[axis]
    for i in range(STATES):
        for j in range(STATES):
            cov[i, j] -= gain[i] * gain[j] / s


@inlined
def update_position(mean: Array, cov: Array, leg: int, foot: Array, var: float, work: Array) -> None:
    """fᵢ − p = `foot` (3,), with variance `var` in each axis; `work` (2, 6) is scratch."""
    f, residual, gain = 2 + leg, work[0], work[1]
    for axis in range(3):
        residual[axis] = foot[axis] - (mean[axis, f] - mean[axis, 0])
    for c in range(2):
        for j in range(STATES):
            gain[j] = cov[c, j, f] - cov[c, j, 0]
        s = gain[f] - gain[0] + var
        _absorb(mean, cov[c], 2 * c, 2 + c, residual, gain, s)


@inlined
def update_velocity(mean: Array, cov: Array, velocity: Array, var: float, work: Array) -> None:
    """v = `velocity` (3,), as `update_position`."""
    residual, gain = work[0], work[1]
    for axis in range(3):
        residual[axis] = velocity[axis] - mean[axis, 1]
    for c in range(2):
        for j in range(STATES):
            gain[j] = cov[c, j, 1]
        _absorb(mean, cov[c], 2 * c, 2 + c, residual, gain, gain[1] + var)


@inlined
def update_height(mean: Array, cov: Array, leg: int, height: float, var: float, work: Array) -> None:
    """fᵢ,z = `height`, as `update_position`."""
    f, residual, gain = 2 + leg, work[0], work[1]
    residual[2] = height - mean[2, f]
    for j in range(STATES):
        gain[j] = cov[1, j, f]
    _absorb(mean, cov[1], 2, 3, residual, gain, gain[f] + var)


@inlined
def surprise(mean: Array, cov: Array, velocity: Array, var: float) -> float:
    """Squared Mahalanobis distance of a velocity (3,) from the filter's."""
    total = 0.0
    for axis in range(3):
        d = velocity[axis] - mean[axis, 1]
        total += d * d / (cov[axis // 2, 1, 1] + var)
    return total
