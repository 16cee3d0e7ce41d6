"""Operating points of the benchmark and of the accuracy survey."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from plant import CrankAnglePlant, Cycle, Engine, ValveCommand
from plant.valve import LATEST_CLOSING_DEG, shortest_duration

CHARGE_BAR, LOSS_BAR = 2e-4, 1e-3  # 1, goals of accuracy
LEAST_CHARGE, LEAST_LOSS = 50e-6, 0.5  # kg, J: errors of less are relative to these

SPEEDS_RPM = tuple(750.0 * k for k in range(1, 9))
# Part I's early closing and its figure 4, and a full load that every speed can drive.
NOMINAL_COMMANDS = (ValveCommand(2.0, 99.0), ValveCommand(3.0, 189.0), ValveCommand(7.0, 220.0))


@dataclass(frozen=True)
class BenchPoint:
    """A plant and its operating point; all cylinders have the same command."""

    speed_rpm: float
    command: ValveCommand
    throttle_deg: float = 90.0
    engine: Engine = field(default_factory=Engine.paper, repr=False)
    runner: bool = True
    oscillation: bool = False
    profile: Literal["camless", "conventional"] = "camless"

    def plant(self, resolution: float = 1.0) -> CrankAnglePlant:
        """Return the point's plant."""
        return CrankAnglePlant(
            self.engine,
            runner=self.runner,
            oscillation=self.oscillation,
            profile=self.profile,
            resolution=resolution,
        )

    def cycle(self, resolution: float = 1.0, tolerance: float = 1e-8) -> Cycle:
        """Return the periodic cycle that the kernel computes."""
        return self.plant(resolution).steady_cycle(
            self.speed_rpm, self.command, self.throttle_deg, tolerance=tolerance
        )

    @cached_property
    def converged_cycle(self) -> Cycle:
        """The kernel's cycle at a fine resolution, where its error is a 500th."""
        return self.cycle(8.0)

    def __str__(self) -> str:
        """Return the point in words."""
        c = self.command
        words = [
            f"{self.speed_rpm:.0f} rpm",
            f"{c.lift_mm:.2f} mm",
            f"{c.opening_deg:.0f} to {c.closing_deg:.0f} deg",
        ]
        if self.throttle_deg < self.engine.throttle.wide_open_deg:
            words.append(f"throttle {self.throttle_deg:.0f} deg")
        if self.profile == "conventional":
            words.append("cam")
        if self.oscillation:
            words.append("oscillation")
        if not self.runner:
            words.append("no runner")
        if self.engine.n_cylinders != Engine().n_cylinders:
            words.append(f"{self.engine.n_cylinders} cylinders")
        return ", ".join(words)


# Where the solvers are compared: one load at each of four speeds.
PEER_POINTS = (
    BenchPoint(750.0, NOMINAL_COMMANDS[0]),
    BenchPoint(1500.0, NOMINAL_COMMANDS[1]),
    BenchPoint(3000.0, NOMINAL_COMMANDS[2]),
    BenchPoint(6000.0, NOMINAL_COMMANDS[2]),
)


def nominal_points() -> list[BenchPoint]:
    """Points at which the kernel's headline time is taken: each command at each speed."""
    return [BenchPoint(s, c) for s in SPEEDS_RPM for c in NOMINAL_COMMANDS]


def random_point(random: np.random.Generator, cylinders: Sequence[int] = (4,)) -> BenchPoint:
    """Draw one operating point that the plant covers.

    Lift, duration, opening and throttle over their ranges, both profiles, oscillation and
    runner on and off; short events at low lift and long ones past BDC are drawn more often.
    """
    engine = Engine(n_cylinders=int(random.choice(cylinders)))
    speed = random.uniform(750.0, 6000.0)
    cam = random.random() < 0.1
    lift = random.uniform(0.5, 8.0) if random.random() < 0.7 else random.uniform(0.3, 2.5)
    opening = random.uniform(-30.0, 40.0) if random.random() < 0.25 else 0.0
    shortest = 6.0 * speed * shortest_duration(lift, engine.valvetrain) * 1.0001
    last = LATEST_CLOSING_DEG - opening
    longest = 280.0 if random.random() < 0.5 else min(LATEST_CLOSING_DEG, last)
    runner = bool(random.random() < 0.7)
    oscillation = bool(random.random() < 0.4) and not cam
    return BenchPoint(
        speed_rpm=speed,
        command=ValveCommand(lift, random.uniform(min(shortest, longest), longest), opening),
        throttle_deg=90.0 if random.random() < 0.8 else random.uniform(14.0, 60.0),
        engine=engine,
        runner=runner,
        oscillation=oscillation,
        profile="conventional" if cam else "camless",
    )


def random_points(count: int, seed: int = 0, cylinders: Sequence[int] = (4,)) -> list[BenchPoint]:
    """Draw points over the feasible map."""
    random = np.random.default_rng(seed)
    return [random_point(random, cylinders) for _ in range(count)]


def relative_errors(
    charge: np.ndarray, loss: np.ndarray, true_charge: np.ndarray, true_loss: np.ndarray
) -> tuple[float, float]:
    """Largest error over the cylinders of charge and of loss.

    Relative to the value itself, or to 50 mg and 0.5 J where it is smaller.
    """
    in_charge = np.abs(charge - true_charge) / np.maximum(np.abs(true_charge), LEAST_CHARGE)
    in_loss = np.abs(loss - true_loss) / np.maximum(np.abs(true_loss), LEAST_LOSS)
    return float(in_charge.max()), float(in_loss.max())
