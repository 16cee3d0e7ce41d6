"""Survey of the kernel's error over the whole range of the plant.

Random points (speed, lift, duration, opening, throttle, cylinders, runner, oscillation, both
profiles) are solved at resolution 1 and at a finer one, whose own error is far smaller; the
worst points are printed. Errors are relative to the value itself, or to 50 mg and 0.5 J
where it is smaller. The second integrator of the tests confirms the finer solution.

Run: python benchmarks/accuracy.py --points 5000 --seed 11
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from cyclopts import App
from rich.progress import track

from plant import CrankAnglePlant, Engine, ValveCommand
from plant.valve import shortest_duration

CHARGE_BAR, LOSS_BAR = 2e-4, 1e-3
LEAST_CHARGE, LEAST_LOSS = 50e-6, 0.5  # kg, J

Point = dict[str, Any]
app = App(help="Survey the kernel's error at random points.")


def random_point(random: np.random.Generator) -> Point:
    """Draw one operating point that the plant covers."""
    engine = Engine(n_cylinders=int(random.choice([1, 3, 4, 6])))
    speed = random.uniform(750.0, 6000.0)
    cam = random.random() < 0.1
    lift = random.uniform(0.5, 8.0) if random.random() < 0.7 else random.uniform(0.3, 2.5)
    opening = random.uniform(-30.0, 40.0) if random.random() < 0.25 else 0.0
    shortest = 6.0 * speed * shortest_duration(lift, engine.valvetrain) * 1.0001
    longest = 280.0 if random.random() < 0.5 else min(360.0, 360.0 - opening)
    options = {
        "profile": "conventional" if cam else "camless",
        "runner": bool(random.random() < 0.7),
        "oscillation": bool(random.random() < 0.4) and not cam,
    }
    return {
        "engine": engine,
        "options": options,
        "speed_rpm": speed,
        "command": ValveCommand(lift, random.uniform(min(shortest, longest), longest), opening),
        "throttle_deg": 90.0 if random.random() < 0.8 else random.uniform(14.0, 60.0),
    }


def solve(point: Point, resolution: float) -> tuple[float, float]:
    """Charge in kg and loss in J of the first cylinder."""
    plant = CrankAnglePlant(point["engine"], resolution=resolution, **point["options"])
    cycle = plant.steady_cycle(
        point["speed_rpm"], point["command"], point["throttle_deg"], tolerance=1e-8
    )
    return float(cycle.air_charge[0]), float(cycle.pumping_loss[0])


@app.default
def survey(points: int = 5000, seed: int = 11, finer: float = 8.0, threads: int = 2) -> int:
    """Print the errors over the points; the status is 1 if a bar is missed."""
    random = np.random.default_rng(seed)
    drawn = [random_point(random) for _ in range(points)]
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
            point = drawn[k]
            print(
                f"  {error[k]:.2e}: {point['speed_rpm']:.3f} rpm, {point['command']}, throttle "
                f"{point['throttle_deg']:.1f} deg, n = {point['engine'].n_cylinders}, "
                f"{point['options']}"
            )
    return int(np.any(errors[:, 0] > CHARGE_BAR) or np.any(errors[:, 1] > LOSS_BAR))


if __name__ == "__main__":
    raise SystemExit(app())
