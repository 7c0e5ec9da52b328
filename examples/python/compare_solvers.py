"""Compare two hand-eye solvers on the same samples: one of fifteen is bad, and the truth is known.

Prints the error of the camera's place by both; draws all runs.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from laboratory.experiments.hand_eye.scenes import measured_with_bad, noise, viewing_scene
from vision_pc.config.choices import Method
from vision_pc.core.hand_eye.solvers.methods import solve

METHODS = (Method.PARK, Method.ROBUST)
picture = Path(sys.argv[1] if len(sys.argv) > 1 else "compare_solvers.png")
errors_mm: dict[Method, list[float]] = {method: [] for method in METHODS}
for seed in range(1, 13):
    rng = np.random.default_rng(seed)
    scene = viewing_scene(rng, poses=15)
    samples, _ = measured_with_bad(scene, noise(0.05, 0.5), rng, bad=1)
    for method in METHODS:  # the same samples for both
        found = solve(samples, method)
        errors_mm[method].append(1e3 * float(np.linalg.norm(found.X[:3, 3] - scene.X[:3, 3])))

figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
for method, errors in errors_mm.items():
    axes.plot(np.sort(errors), np.linspace(0.0, 1.0, len(errors)), "o-", label=method)
    print(f"{method}: median {np.median(errors):.2f} mm, worst {max(errors):.2f} mm")
axes.set(xscale="log", xlabel="error of the camera's place, mm", ylabel="share of runs", title="1 of 15 bad")
axes.legend()
figure.savefig(picture, dpi=90)
