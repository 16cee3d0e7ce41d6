"""Steady operating points as the validation needs them, each simulated once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .crank_angle import CrankAnglePlant, Orifice, Profile
from .parameters import Engine
from .valve import ValveCommand

WIDE_OPEN_DEG = 90.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """Charge and loss of a steady cycle, the mean over the cylinders."""

    charge_mg: float
    loss_J: float  # noqa: N815  (the unit is J)
    lift_mm: float  # delivered, least of the cylinders

    @property
    def specific_loss(self) -> float:
        """Pumping loss over charge, J/g."""
        return 1e3 * self.loss_J / self.charge_mg


class Experiments:
    """An engine on the test bench: operating points by name, remembered once run.

    Parameters
    ----------
    engine : Engine
        The engine.
    runner : bool
        Whether its runners resonate, where an experiment does not say otherwise.
    orifice, resolution
        As for `CrankAnglePlant`.
    """

    def __init__(self, engine: Engine, *, runner: bool, orifice: Orifice, resolution: float):
        self.engine = engine
        self.runner = runner
        self.orifice = orifice
        self.resolution = resolution
        self._plants: dict[tuple[str, bool, bool], CrankAnglePlant] = {}
        self._outcomes: dict[tuple[str, bool, bool, float, ValveCommand, float], Outcome] = {}

    def replace_engine(self, engine: Engine) -> Experiments:
        """Return the same bench with another engine."""
        return Experiments(
            engine, runner=self.runner, orifice=self.orifice, resolution=self.resolution
        )

    def plant(
        self, profile: Profile = "camless", *, runner: bool | None = None, oscillation: bool = False
    ) -> CrankAnglePlant:
        """Return the plant of these options."""
        key = profile, self.runner if runner is None else runner, oscillation
        if key not in self._plants:
            self._plants[key] = CrankAnglePlant(
                self.engine,
                runner=key[1],
                oscillation=oscillation,
                profile=profile,
                orifice=self.orifice,
                resolution=self.resolution,
            )
        return self._plants[key]

    def run(
        self,
        speed_rpm: float,
        command: ValveCommand,
        throttle_deg: float = WIDE_OPEN_DEG,
        *,
        profile: Profile = "camless",
        runner: bool | None = None,
        oscillation: bool = False,
    ) -> Outcome:
        """Return the steady outcome; a lift that the duration does not allow is limited."""
        runner = self.runner if runner is None else runner
        key = profile, runner, oscillation, speed_rpm, command, throttle_deg
        if key not in self._outcomes:
            cycle = self.plant(profile, runner=runner, oscillation=oscillation).steady_cycle(
                speed_rpm, command, throttle_deg, on_infeasible="limit"
            )
            self._outcomes[key] = Outcome(
                charge_mg=1e6 * float(np.mean(cycle.air_charge)),
                loss_J=float(np.mean(cycle.pumping_loss)),
                lift_mm=float(np.min(cycle.delivered_lift_mm)),
            )
        return self._outcomes[key]

    def closing_at(
        self,
        speed_rpm: float,
        lift_mm: float,
        closing_deg: float,
        *,
        runner: bool | None = None,
        oscillation: bool = False,
    ) -> Outcome:
        """Return the steady outcome for IVO at TDC and a closing timing in deg after it.

        The duration is the closing timing plus the seating (section 3.1).
        """
        return self.run(
            speed_rpm,
            self.closing_command(speed_rpm, lift_mm, closing_deg),
            runner=runner,
            oscillation=oscillation,
        )

    def closing_command(self, speed_rpm: float, lift_mm: float, closing_deg: float) -> ValveCommand:
        """Return the command whose seating begins at a closing timing in deg after TDC."""
        seating_deg = 6.0 * speed_rpm * self.engine.valvetrain.seating_duration
        return ValveCommand(lift_mm=lift_mm, duration_deg=closing_deg + seating_deg)
