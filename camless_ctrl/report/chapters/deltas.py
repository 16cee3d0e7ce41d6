"""Chapter: what the reduction ignores, as deltas over the operating range."""

from __future__ import annotations

from typing import TYPE_CHECKING

from uncertainty.delta_result import DeltaResult
from uncertainty.deltas import ActuatorOscillationDelta, HelmholtzDelta

from ..chapter import Context
from ..content import Block, Cell, ChapterResult, Column, Figure, Heading, Number, Table, Text

if TYPE_CHECKING:
    import xarray as xr


class DeltasChapter:
    """The Helmholtz runner and the actuator oscillation, over speed."""

    id = "deltas"
    title = "What the reduction ignores"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Evaluate both deltas on the default grid."""
        results = {
            "helmholtz": HelmholtzDelta().evaluate(context.engine),
            "oscillation": ActuatorOscillationDelta().evaluate(context.engine),
        }
        numbers = {
            f"{id}_{quantity}": Number(100.0 * abs(result.worst(quantity).value), "%")
            for id, result in results.items()
            for quantity in ("charge", "loss", "sensitivity")
        }
        blocks: list[Block] = [
            Text(
                "A delta is the change that an effect makes to charge, pumping loss and "
                "sensitivity of the charge to duration: the full plant with the effect against the "
                "full plant without it, at every feasible point of a grid of lift, duration and "
                "speed. It is what a controller must bear if its map leaves the effect out. "
                "Changes are taken of the nominal value, or of 50 mg, 0.5 J and 1 mg/deg where "
                "that is smaller."
            )
        ]
        for id, result in results.items():
            blocks += [
                Heading(result.name[0].upper() + result.name[1:]),
                _figure(context, id, result),
                _table(id, result),
            ]
        return ChapterResult(
            finding=Text(
                "The runner changes the charge by up to {helmholtz_charge:.0f} and the actuator "
                "oscillation by up to {oscillation_charge:.1f} over the operating range.",
                **numbers,
            ),
            blocks=blocks,
            numbers=numbers,
        )


def _figure(context: Context, id: str, result: DeltaResult) -> Figure:
    envelope = result.over_speed()
    low, high = float(envelope["speed"][0]), float(envelope["speed"][-1])
    rms = envelope["charge"].sel(statistic="rms")
    worst = result.worst_charge
    return Figure(
        id,
        Text(
            f"{{effect}} changes the charge by up to {{{id}_worst:+.1f}} (at {{where}}) and the "
            f"loss by up to {{{id}_worst_loss:+.1f}} (at {{where_loss}}). The rms change of "
            f"the charge goes from {{{id}_rms_low:.2f}} at {{low:.0f}} to {{{id}_rms_high:.2f}} at "
            "{high:.0f}.",
            effect=result.effect,
            where=str(worst.at),
            where_loss=str(result.worst_loss.at),
            low=Number(low, "rpm"),
            high=Number(high, "rpm"),
            **{
                f"{id}_worst": Number(100.0 * worst.value, "%"),
                f"{id}_worst_loss": Number(100.0 * result.worst_loss.value, "%"),
                f"{id}_rms_low": Number(100.0 * float(rms[0]), "%"),
                f"{id}_rms_high": Number(100.0 * float(rms[-1]), "%"),
            },
        ),
        f"Lowest, highest and rms change of charge and pumping loss by the {result.name}, against "
        "speed.",
        context.draw(result.plot()),
    )


def _table(id: str, result: DeltaResult) -> Table:
    envelope: xr.Dataset = result.over_speed()
    columns, statistics = [Column("speed", "rpm", ".0f")], ("min", "max", "rms")
    for quantity in ("charge", "loss", "sensitivity"):
        columns += [
            Column(f"{quantity} {statistic}", "%", "+.1f" if statistic != "rms" else ".1f")
            for statistic in statistics
        ]
    rows: list[list[Cell]] = [
        [
            float(speed),
            *(
                100.0 * float(envelope[quantity].sel(speed=speed, statistic=statistic))
                for quantity in ("charge", "loss", "sensitivity")
                for statistic in statistics
            ),
        ]
        for speed in envelope["speed"].to_numpy()
    ]
    return Table(
        f"{id}-over-speed",
        Text(
            "{name}: change of charge, loss and sensitivity of the charge to duration, over all "
            "feasible lifts and durations at a speed.",
            name=result.name[0].upper() + result.name[1:],
        ),
        columns,
        rows,
    )
