"""Parameters of the engine as frozen dataclasses, a unit on every field.

The published values are those of Part I (Appendices A and B, sections 2 to 4); the
identified ones are marked. Variants come from ``.replace(...)``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, Self

from ._checks import in_range, positive, replace_fields, whole
from .errors import ParameterError

PRINTED_TEMPERATURE = 316.0  # K, as printed in section 2.2; see Engine.paper
PRINTED_RUNNER_AREA = 1.43e-4  # m2, as printed in Appendix A; see Engine.paper


class _Replaceable:
    """Adds ``replace``, which refuses unknown fields."""

    __slots__ = ()

    def replace(self, **changes: Any) -> Self:
        """Return a copy with the given fields changed.

        Raises
        ------
        ParameterError
            If a field is unknown or a value impossible.
        """
        return replace_fields(self, changes)


@dataclass(frozen=True, slots=True)
class Valvetrain(_Replaceable):
    """Springless electro-hydraulic valvetrain (section 2.3, Eq. 20, Appendix B).

    The slopes and `roundness` are identified or assumed: see `Engine.paper`.
    """

    opening_slope_mm_s: float = 3500.0  # s_r, mm/s, identified
    closing_slope_mm_s: float = 3500.0  # s_c, mm/s, identified (taken equal to s_r)
    seating_slope_mm_s: float = 200.0  # s_s, mm/s, assumed
    seating_duration: float = 1e-3  # d_s, s, implied by IVD 189 deg for closing 180 deg
    roundness: float = 0.3  # lambda, 1, assumed: share of the lift that is approached exponentially
    maximum_lift_mm: float = 8.0  # mm, highest lift that the actuator accepts, assumed
    oscillation_amplitude: float = 0.21  # 1, share of the lift (Appendix B)
    oscillation_period: float = 2.5e-3  # T_s, s (Appendix B)
    oscillation_decay_ratio: float = 0.17 / 0.21  # 1, amplitude left after T_s/4 (Appendix B)

    def __post_init__(self) -> None:
        positive("opening_slope_mm_s", self.opening_slope_mm_s, "mm/s")
        positive("closing_slope_mm_s", self.closing_slope_mm_s, "mm/s")
        positive("seating_slope_mm_s", self.seating_slope_mm_s, "mm/s")
        positive("seating_duration", self.seating_duration, "s")
        in_range("roundness", self.roundness, 0.0, 1.0, "1", open_low=True, open_high=True)
        positive("maximum_lift_mm", self.maximum_lift_mm, "mm")
        in_range("oscillation_amplitude", self.oscillation_amplitude, 0.0, 1.0, "1")
        positive("oscillation_period", self.oscillation_period, "s")
        in_range(
            "oscillation_decay_ratio", self.oscillation_decay_ratio, 0.0, 1.0, "1", open_low=True
        )

    @property
    def oscillation_decay_rate(self) -> float:
        """Rate of decay ``a_e`` of the oscillation, 1/s (Appendix B)."""
        return -4.0 / self.oscillation_period * math.log(self.oscillation_decay_ratio)

    @property
    def lowest_lift_mm(self) -> float:
        """Lift below which the falling ramp of Eq. 20 would start under the seating height, mm."""
        return self.seating_slope_mm_s * self.seating_duration / (1.0 - self.roundness)


@dataclass(frozen=True, slots=True)
class HelmholtzRunner(_Replaceable):
    """Helmholtz resonator of an intake runner, Eq. 7: frequency and damping against speed.

    Section 4 gives one pair at 1500 rpm and one at 3000 and 4000 rpm; both are held outside
    and linear in speed between them.
    """

    low_speed_rpm: float = 1500.0  # rpm
    high_speed_rpm: float = 3000.0  # rpm
    low_speed_frequency_hz: float = 176.0  # w_h/(2 pi), Hz, at low_speed_rpm and below
    high_speed_frequency_hz: float = 190.0  # w_h/(2 pi), Hz, at high_speed_rpm and above
    low_speed_damping: float = 0.005  # xi_h, 1
    high_speed_damping: float = 0.15  # xi_h, 1

    def __post_init__(self) -> None:
        positive("low_speed_rpm", self.low_speed_rpm, "rpm")
        positive("high_speed_rpm", self.high_speed_rpm, "rpm")
        if self.high_speed_rpm <= self.low_speed_rpm:
            raise ParameterError(
                f"high_speed_rpm is {self.high_speed_rpm:g} rpm, but must be above "
                f"low_speed_rpm = {self.low_speed_rpm:g} rpm"
            )
        positive("low_speed_frequency_hz", self.low_speed_frequency_hz, "Hz")
        positive("high_speed_frequency_hz", self.high_speed_frequency_hz, "Hz")
        for name in ("low_speed_damping", "high_speed_damping"):
            in_range(
                name,
                getattr(self, name),
                0.0,
                1.0,
                "1",
                open_low=True,
                open_high=True,
                remedy="Eq. 7 is solved for an underdamped runner",
            )

    @classmethod
    def constant(cls, frequency_hz: float, damping: float) -> Self:
        """Return a runner whose frequency (Hz) and damping ratio hold at every speed."""
        return cls(
            low_speed_frequency_hz=frequency_hz,
            high_speed_frequency_hz=frequency_hz,
            low_speed_damping=damping,
            high_speed_damping=damping,
        )

    def natural_frequency(self, speed_rpm: float) -> float:
        """Natural frequency ``w_h`` in rad/s at a speed in rpm."""
        return (
            2.0
            * math.pi
            * between_speeds(
                self.low_speed_frequency_hz,
                self.high_speed_frequency_hz,
                self.low_speed_rpm,
                self.high_speed_rpm,
                speed_rpm,
            )
        )

    def damping_ratio(self, speed_rpm: float) -> float:
        """Damping ratio ``xi_h`` at a speed in rpm."""
        return between_speeds(
            self.low_speed_damping,
            self.high_speed_damping,
            self.low_speed_rpm,
            self.high_speed_rpm,
            speed_rpm,
        )


def between_speeds(
    low: float, high: float, low_speed_rpm: float, high_speed_rpm: float, speed_rpm: float
) -> float:
    """Value that is held outside two speeds and linear in speed between them (section 4)."""
    share = (speed_rpm - low_speed_rpm) / (high_speed_rpm - low_speed_rpm)
    return low + (high - low) * min(max(share, 0.0), 1.0)


@dataclass(frozen=True, slots=True)
class Throttle(_Replaceable):
    """Effective area of the throttle body, Eq. 19, normalised at sonic flow (kg/s).

    ``A_phi = scale * (constant + linear * phi + quadratic * phi**2)``, `phi` in degrees.
    """

    scale: float = 1.268e-4  # kg/s
    constant: float = -0.2215  # 1
    linear: float = -2.275  # 1/deg
    quadratic: float = 0.23  # 1/deg2
    wide_open_deg: float = 90.0  # deg

    def __post_init__(self) -> None:
        positive("scale", self.scale, "kg/s")
        in_range("constant", self.constant, -1e6, 1e6, "1")
        in_range("linear", self.linear, -1e6, 1e6, "1/deg")
        positive("quadratic", self.quadratic, "1/deg2")
        in_range("wide_open_deg", self.wide_open_deg, 0.0, 90.0, "deg", open_low=True)
        if self.area(self.wide_open_deg) <= 0.0:
            raise ParameterError(
                f"the throttle area at {self.wide_open_deg:g} deg is "
                f"{self.area(self.wide_open_deg):g} kg/s, but must be above 0: check the "
                "coefficients of Eq. 19"
            )

    def area(self, throttle_deg: float) -> float:
        """Effective area in kg/s at a throttle angle in degrees (Eq. 19, without a floor)."""
        return self.scale * (
            self.constant + self.linear * throttle_deg + self.quadratic * throttle_deg**2
        )

    @property
    def closed_deg(self) -> float:
        """Largest angle at which Eq. 19 gives no opening, deg (about 10 for the paper's)."""
        root = self.linear**2 - 4.0 * self.quadratic * self.constant
        if root < 0.0:
            return 0.0
        return max((-self.linear + math.sqrt(root)) / (2.0 * self.quadratic), 0.0)


@dataclass(frozen=True, slots=True)
class Engine(_Replaceable):
    """Engine whose intake process is modelled (Appendix A, sections 2 to 4).

    The defaults are the identified paper engine, `Engine.paper`.
    """

    n_cylinders: int = 4  # 1
    manifold_volume: float = 1e-3  # V_m, m3
    runner_area: float = 1.43e-3  # A_r, m2 (corrected: see Engine.paper)
    runner_volume: float = 5e-4  # V_r, m3
    runner_constant: float = 1.288  # k_r, 1
    displaced_volume: float = 4e-4  # V_d, m3
    clearance_volume: float = 4e-5  # V_cl, m3
    bore: float = 0.0806  # B, m
    stroke: float = 0.088  # S, m
    flow_coefficient: float = 0.0175  # alpha, kg/s per mm of lift
    ambient_pressure: float = 1e5  # p_o, Pa
    exhaust_pressure: float = 1.1e5  # p_exh, Pa
    gas_constant: float = 287.0  # R, J/(kg K)
    temperature: float = 290.0  # T, K, identified (see Engine.paper)
    valvetrain: Valvetrain = field(default_factory=Valvetrain)
    helmholtz: HelmholtzRunner = field(default_factory=HelmholtzRunner)
    throttle: Throttle = field(default_factory=Throttle)
    cylinder_flow_factors: tuple[float, ...] = ()  # 1, per cylinder; empty means all 1

    def __post_init__(self) -> None:
        # Stored as plain numbers, so that NumPy scalars neither print nor hash differently.
        object.__setattr__(self, "n_cylinders", whole("n_cylinders", self.n_cylinders, 1, 24))
        for name, unit in _POSITIVE_FIELDS.items():
            object.__setattr__(self, name, positive(name, getattr(self, name), unit))
        for name, kind in (
            ("valvetrain", Valvetrain),
            ("helmholtz", HelmholtzRunner),
            ("throttle", Throttle),
        ):
            if not isinstance(getattr(self, name), kind):
                raise ParameterError(
                    f"{name} is {getattr(self, name)!r}, but must be a {kind.__name__}"
                )
        given = self.cylinder_flow_factors
        if isinstance(given, str) or not isinstance(given, Iterable):
            raise ParameterError(
                f"cylinder_flow_factors is {given!r}, but must be a tuple of numbers: one per "
                "cylinder, or none"
            )
        factors = tuple(
            positive(f"cylinder_flow_factors[{i}]", value, "1") for i, value in enumerate(given)
        )
        if factors and len(factors) != self.n_cylinders:
            raise ParameterError(
                f"cylinder_flow_factors has {len(factors)} values, but the engine has "
                f"{self.n_cylinders} cylinders: give one value per cylinder, or none"
            )
        object.__setattr__(self, "cylinder_flow_factors", factors)

    @classmethod
    def paper(cls) -> Self:
        """Return the engine that reproduces the figures published in Part I.

        Two printed values are not used. The runner area is 1.43e-3 m2: the printed 1.43e-4
        gives a runner pressure swing of 190 kPa, and no simulation of it survives. The
        temperature is 290 K: with the printed 316 K every published charge comes out 4 to
        9 % low; a least-squares fit to the nine published figures gives 290.7 K and slopes
        of 3502 mm/s, of which 290 K and 3500 mm/s are the rounded values. The printed
        temperature is one argument away: ``Engine.paper().replace(temperature=316.0)``.
        """
        return cls()

    @property
    def event_angle_deg(self) -> float:
        """Crank angle between two intake events, ``720/n`` deg."""
        return 720.0 / self.n_cylinders

    @property
    def flow_coefficients(self) -> tuple[float, ...]:
        """Flow coefficient of each cylinder, kg/s per mm."""
        factors = self.cylinder_flow_factors or (1.0,) * self.n_cylinders
        return tuple(self.flow_coefficient * factor for factor in factors)


_POSITIVE_FIELDS = {
    "manifold_volume": "m3",
    "runner_area": "m2",
    "runner_volume": "m3",
    "runner_constant": "1",
    "displaced_volume": "m3",
    "clearance_volume": "m3",
    "bore": "m",
    "stroke": "m",
    "flow_coefficient": "kg/s/mm",
    "ambient_pressure": "Pa",
    "exhaust_pressure": "Pa",
    "gas_constant": "J/(kg K)",
    "temperature": "K",
}
