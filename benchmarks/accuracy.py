"""Survey of the kernel's error over the whole range of the plant.

Random points (speed, lift, duration, opening, throttle, cylinders, runner, oscillation, both
profiles) are solved at resolution 1 and at a finer one, whose own error is far smaller; the
worst points are printed. Errors are relative to the value itself, or to 50 mg and 0.5 J
where it is smaller. The second integrator of the tests confirms the finer solution.

Run: python benchmarks/accuracy.py --points 5000 --seed 11
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from cyclopts import App
from rich.progress import track

from camless_ctrl.bench.points import (
    CHARGE_BAR,
    LEAST_CHARGE,
    LEAST_LOSS,
    LOSS_BAR,
    BenchPoint,
    random_points,
)

app = App(help="Survey the kernel's error at random points.")


def solve(point: BenchPoint, resolution: float) -> tuple[float, float]:
    """Charge in kg and loss in J of the first cylinder."""
    cycle = point.cycle(resolution)
    return float(cycle.air_charge[0]), float(cycle.pumping_loss[0])


@app.default
def survey(points: int = 5000, seed: int = 11, finer: float = 8.0, threads: int = 2) -> int:
    """Print the errors over the points; the status is 1 if a bar is missed."""
    drawn = random_points(points, seed, cylinders=(1, 3, 4, 6))
    results = []
    with ThreadPoolExecutor(threads) as pool:
        for resolution in (1.0, finer):
            solved = pool.map(lambda point, r=resolution: solve(point, r), drawn)
            results.append(
                np.array(list(track(solved, f"resolution {resolution:g}", total=points)))
            )
    usual, reference = results
    floor = np.array([LEAST_CHARGE, LEAST_LOSS])
    errors = np.abs(usual - reference) / np.maximum(np.abs(reference), floor)
    for column, name, bar in ((0, "charge", CHARGE_BAR), (1, "loss", LOSS_BAR)):
        error = errors[:, column]
        print(
            f"{name}: worst {error.max():.2e}, 99 % {np.quantile(error, 0.99):.2e}, rms "
            f"{np.sqrt(np.mean(error**2)):.2e}; {int(np.sum(error > bar))} of {points} points over "
            f"the bar of {bar:g}"
        )
        for k in np.argsort(-error)[:3]:
            print(f"  {error[k]:.2e}: {drawn[k]}")
    return int(np.any(errors[:, 0] > CHARGE_BAR) or np.any(errors[:, 1] > LOSS_BAR))


if __name__ == "__main__":
    raise SystemExit(app())
