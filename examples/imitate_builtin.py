"""Optimises a built-in gait for the A1 and says what it was worth: the main job in a dozen lines.

python examples/imitate_builtin.py [--fast]
"""

import sys

import fastmimic as fm

iterations = 3 if "--fast" in sys.argv else 200
result = fm.imitate("trot", robot="a1", iterations=iterations, population=10, duration_s=5.0, seed=0)

metrics = result.metrics()
for name in ("reward", "fell", "foot_z_rmse_m", "foot_x_rmse_m"):
    print(f"{name:14} before {metrics[name]['before']:.4g}  after {metrics[name]['after']:.4g}")
for parameter, value in zip(result.parameters, result.values, strict=True):
    print(f"{parameter.name:20} {parameter.initial:+.4f} -> {value:+.4f} {parameter.unit}")

result.motion.save("runs/trot.npz")
print(f"{result.motion.n_samples} samples at {result.motion.rate_hz:g} Hz in runs/trot.npz")
