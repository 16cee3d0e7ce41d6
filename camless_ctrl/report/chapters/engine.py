"""Chapter: the engine, and where each of its values comes from."""

from __future__ import annotations

import dataclasses
from typing import Any

from plant import CrankAnglePlant, Engine, SimulationError, ValveCommand
from plant.parameters import PRINTED_RUNNER_AREA, PRINTED_TEMPERATURE

from ..chapter import Context
from ..content import Cell, ChapterResult, Column, Number, Table, Text

POINT_RPM = 1500.0
POINT = ValveCommand(lift_mm=3.0, duration_deg=189.0)  # Fig. 4
PUBLISHED_MG = 473.0  # section 3.1

# Field: symbol, unit, status, source (Part I unless said otherwise).
PROVENANCE: dict[str, tuple[str, str, str, str]] = {
    "n_cylinders": ("n", "1", "published", "section 2"),
    "manifold_volume": ("V_m", "m³", "published", "Appendix A"),
    "runner_area": ("A_r", "m²", "corrected", "Appendix A prints 1.43e-4, which cannot run"),
    "runner_volume": ("V_r", "m³", "published", "Appendix A"),
    "runner_constant": ("k_r", "1", "published", "Appendix A"),
    "displaced_volume": ("V_d", "m³", "published", "Appendix A; bore and stroke give 4.49e-4"),
    "clearance_volume": ("V_cl", "m³", "published", "Appendix A"),
    "bore": ("B", "m", "published", "Appendix A"),
    "stroke": ("S", "m", "published", "Appendix A"),
    "flow_coefficient": ("α", "kg/(s mm)", "published", "Eq. 16–17"),
    "ambient_pressure": ("p_o", "Pa", "published", "Appendix A"),
    "exhaust_pressure": ("p_exh", "Pa", "published", "section 3"),
    "gas_constant": ("R", "J/(kg K)", "published", "Appendix A"),
    "temperature": ("T", "K", "identified", "least squares on nine published figures: 290.7 K"),
    "cylinder_flow_factors": ("", "1", "assumed", "equal cylinders"),
    "valvetrain.opening_slope_mm_s": (
        "s_r",
        "mm/s",
        "identified",
        "least squares on nine published figures: 3502 mm/s",
    ),
    "valvetrain.closing_slope_mm_s": ("s_c", "mm/s", "identified", "taken equal to s_r"),
    "valvetrain.seating_slope_mm_s": ("s_s", "mm/s", "assumed", "the figures hardly depend on it"),
    "valvetrain.seating_duration": (
        "d_s",
        "s",
        "published",
        "implied in section 3.1: duration 189° for closing at 180°, at 1500 rpm",
    ),
    "valvetrain.roundness": ("λ", "1", "assumed", "the figures hardly depend on it"),
    "valvetrain.maximum_lift_mm": ("", "mm", "assumed", "range of the actuator"),
    "valvetrain.oscillation_amplitude": ("", "1", "published", "Appendix B"),
    "valvetrain.oscillation_period": ("T_s", "s", "published", "Appendix B"),
    "valvetrain.oscillation_decay_ratio": ("", "1", "published", "Appendix B"),
    "helmholtz.low_speed_rpm": ("", "rpm", "published", "section 4"),
    "helmholtz.high_speed_rpm": ("", "rpm", "published", "section 4"),
    "helmholtz.low_speed_frequency_hz": ("ω_h/2π", "Hz", "published", "section 4"),
    "helmholtz.high_speed_frequency_hz": ("ω_h/2π", "Hz", "published", "section 4"),
    "helmholtz.low_speed_damping": ("ξ_h", "1", "published", "section 4"),
    "helmholtz.high_speed_damping": ("ξ_h", "1", "published", "section 4"),
    "throttle.scale": ("", "kg/s", "published", "Eq. 19"),
    "throttle.constant": ("", "1", "published", "Eq. 19"),
    "throttle.linear": ("", "1/deg", "published", "Eq. 19"),
    "throttle.quadratic": ("", "1/deg²", "published", "Eq. 19"),
    "throttle.wide_open_deg": ("", "deg", "published", "section 2.2"),
}


class EngineChapter:
    """Values of the engine with unit and provenance, and what the two corrections do."""

    id = "engine"
    title = "The engine and where its values come from"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Tabulate the engine, and compute what the printed values would give."""
        engine, paper = context.engine, Engine.paper()
        values, published = leaves(engine), leaves(paper)
        changed = [name for name in values if values[name] != published[name]]
        rows: list[list[Cell]] = []
        for name, value in values.items():
            symbol, unit, status, source = PROVENANCE[name]
            if name in changed:
                status, source = "changed", f"{_shown(published[name])} in the paper's engine"
            rows.append([name, symbol, _shown(value), unit, status, source])
        table = Table(
            "parameters",
            Text(
                "The engine. Published: as in Part I. Identified: fitted to its figures. "
                "Assumed: no source exists. Corrected: not as printed."
            ),
            [
                Column("parameter"),
                Column("symbol"),
                Column("value"),
                Column("unit"),
                Column("status"),
                Column("source"),
            ],
            rows,
        )
        count = {
            status: Number(sum(row[4] == status for row in rows))
            for status in ("published", "identified", "assumed", "corrected", "changed")
        }
        return ChapterResult(
            finding=Text(
                "{published:.0f} of {total:.0f} values are published, {identified:.0f} identified, "
                "{corrected:.0f} corrected, {assumed:.0f} assumed and {changed:.0f} changed by "
                "the user.",
                total=Number(len(rows)),
                **count,
            ),
            blocks=[
                Text(
                    "The model is that of Part I of the source paper (crank-angle based, "
                    "isothermal intake process of an engine whose intake valves are driven "
                    "electro-hydraulically). Two printed values are not used, and the reason can "
                    "be computed."
                ),
                self._temperature(),
                self._runner_area(),
                table,
            ],
            numbers={
                name: Number(float(value), PROVENANCE[name][1])
                for name, value in values.items()
                if not isinstance(value, tuple)
            },
        )

    @staticmethod
    def _temperature() -> Text:
        charge = {
            kelvin: 1e6
            * CrankAnglePlant(Engine.paper().replace(temperature=kelvin))
            .steady_cycle(POINT_RPM, POINT)
            .air_charge[0]
            for kelvin in (Engine.paper().temperature, PRINTED_TEMPERATURE)
        }
        identified, printed = charge.values()
        return Text(
            "Temperature. The charge printed for Figure 4 (1500 rpm, 3 mm, 189°) is "
            "{printed_charge:.0f}. With the printed temperature of {printed_temperature:.0f} the "
            "model gives {charge_printed:.1f} ({printed_error:+.1f}); with the identified "
            "{temperature:.0f} it gives {charge_identified:.1f} ({identified_error:+.1f}). Every "
            "published charge asks for the same correction, so the paper's engine here is the "
            "identified one.",
            printed_charge=Number(PUBLISHED_MG, "mg"),
            printed_temperature=Number(PRINTED_TEMPERATURE, "K"),
            temperature=Number(Engine.paper().temperature, "K"),
            charge_printed=Number(printed, "mg"),
            charge_identified=Number(identified, "mg"),
            printed_error=Number(100.0 * (printed / PUBLISHED_MG - 1.0), "%"),
            identified_error=Number(100.0 * (identified / PUBLISHED_MG - 1.0), "%"),
        )

    @staticmethod
    def _runner_area() -> Text:
        plant = CrankAnglePlant(Engine.paper().replace(runner_area=PRINTED_RUNNER_AREA))
        try:
            plant.steady_cycle(POINT_RPM, POINT)
        except SimulationError:
            outcome = "the runner pressure falls below zero and the simulation stops"
        else:
            outcome = "the simulation runs all the same"
        return Text(
            "Runner area. With the printed {printed_area:.2e} {outcome}; the value used is "
            "{area:.2e}.",
            printed_area=Number(PRINTED_RUNNER_AREA, "m²"),
            area=Number(Engine.paper().runner_area, "m²"),
            outcome=outcome,
        )


def leaves(engine: Engine) -> dict[str, Any]:
    """Return every value of an engine under its dotted name."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(engine):
        value = getattr(engine, field.name)
        if dataclasses.is_dataclass(value):
            for inner in dataclasses.fields(value):
                found[f"{field.name}.{inner.name}"] = getattr(value, inner.name)
        else:
            found[field.name] = value
    # Scalars first, parts after them.
    return dict(sorted(found.items(), key=lambda item: "." in item[0]))


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ", ".join(f"{factor:g}" for factor in value) if value else "all 1"
    return f"{value:.6g}"
