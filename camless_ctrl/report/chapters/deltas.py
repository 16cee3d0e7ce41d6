"""Chapter: what the reduction ignores, as deltas over the operating range."""

from __future__ import annotations

from uncertainty.delta_result import QUANTITIES, DeltaResult, Quantity
from uncertainty.deltas import AllDeltas, SensorDelta, evaluate_all

from ..chapter import Context
from ..content import Block, Cell, ChapterResult, Column, Figure, Heading, Number, Table, Text

_SPEEDS_RPM = (750.0, 1500.0, 3000.0, 6000.0)
_SENSITIVITIES: tuple[Quantity, ...] = tuple(q for q in QUANTITIES if "_by_" in q)
# name in the JSON file, name of the result, its case with the values of the engine
_SHOWN = (
    ("helmholtz", "Helmholtz runner", "runner"),
    ("oscillation", "actuator oscillation", "oscillation"),
)


class DeltasChapter:
    """Runner, actuator, parameters and sensors, each for itself and all together."""

    id = "deltas"
    title = "What the reduction ignores"
    concludes = False

    def compute(self, context: Context) -> ChapterResult:
        """Evaluate the default deltas on the default grid."""
        deltas = context.shared("deltas", lambda: evaluate_all(context.engine))
        results = {id: deltas[name] for id, name, _ in _SHOWN}
        identified = {id: deltas[name].only(case) for id, name, case in _SHOWN}
        numbers: dict[str, Number] = {}
        for id in results:
            for quantity in ("charge", "loss", "charge_by_duration"):
                numbers[f"{id}_{quantity}"] = _size(identified[id], quantity)
                numbers[f"{id}_any_{quantity}"] = _size(results[id], quantity)
        numbers["parameters_charge"] = _size(deltas["parameters"], "charge")
        numbers["joint_charge"] = _size(deltas.joint, "charge")
        numbers["interaction_charge"] = _percent(deltas.joint.interaction("charge").value)
        blocks: list[Block] = [_introduction()]
        for id, result in results.items():
            blocks += [
                Heading(_capital(result.name)),
                _envelope(context, id, result, identified[id]),
                _map(context, id, result),
                _over_speed(id, result, identified[id]),
            ]
        blocks += [
            Heading("All deltas"),
            _parameters(),
            _worst(deltas),
            _sensitivities(deltas),
            Heading("All at once"),
            _together(deltas),
            _interaction(deltas),
            Heading("Sensors and modes"),
            _sensors(),
            _modes(context),
        ]
        return ChapterResult(
            finding=Text(
                "The runner changes the charge by up to {helmholtz_charge:.0f} as identified and "
                "{helmholtz_any_charge:.0f} within its ranges, the valve actuator by up to "
                "{oscillation_charge:.0f} and {oscillation_any_charge:.0f}; with parameters and "
                "sensors on top it is up to {joint_charge:.0f}. The sum of the single changes "
                "misses the joint one by up to {interaction_charge:+.0f}.",
                **numbers,
            ),
            blocks=blocks,
            numbers=numbers,
        )


def _introduction() -> Text:
    return Text(
        "A delta is the change that an uncertainty makes to charge, pumping loss and their "
        "sensitivities to duration and lift: perturbed full plants, its cases, against a nominal "
        "one, at every feasible point of a grid of lift, duration and speed. It is what a "
        "controller must bear if its map leaves the effect out. Changes are taken of the nominal "
        "value, or of a floor where that is smaller: 50 mg, 1 mg/deg and 10 mg/mm; 0.5 J, "
        "0.01 J/deg and 0.1 J/mm. Runner and oscillation are those of Part I; no range of any "
        "parameter is published, so all ranges are assumptions."
    )


def _envelope(context: Context, id: str, result: DeltaResult, identified: DeltaResult) -> Figure:
    rms = identified.over_speed()["charge"].sel(statistic="rms")
    low, high = float(rms["speed"][0]), float(rms["speed"][-1])
    charge, loss = result.worst_charge, result.worst_loss
    return Figure(
        id,
        Text(
            f"{{effect}} changes the charge by up to {{{id}_worst:+.1f}} (at {{where}}; {{case}}) "
            f"and the loss by up to {{{id}_worst_loss:+.1f}} (at {{where_loss}}; {{case_loss}}). "
            f"As identified, the rms change of the charge goes from {{{id}_rms_low:.2f}} at "
            f"{{low:.0f}} to {{{id}_rms_high:.2f}} at {{high:.0f}}.",
            effect=result.effect,
            where=str(charge.at),
            case=charge.case,
            where_loss=str(loss.at),
            case_loss=loss.case,
            low=Number(low, "rpm"),
            high=Number(high, "rpm"),
            **{
                f"{id}_worst": _percent(charge.value),
                f"{id}_worst_loss": _percent(loss.value),
                f"{id}_rms_low": _percent(float(rms[0])),
                f"{id}_rms_high": _percent(float(rms[-1])),
            },
        ),
        f"Lowest, highest and rms change of charge and pumping loss by the {result.name}, against "
        "speed.",
        context.draw(result.plot()),
    )


def _map(context: Context, id: str, result: DeltaResult) -> Figure:
    speed = result.worst_charge.at.speed_rpm
    return Figure(
        f"{id}-map",
        Text(
            f"Largest change of the charge at {{{id}_map_speed:.0f}}, where it is worst, over "
            "lift and duration.",
            **{f"{id}_map_speed": Number(speed, "rpm")},
        ),
        f"Change of the charge by the {result.name} over lift and duration, as coloured cells "
        "with their numbers.",
        context.draw(result.plot_map("charge", speed_rpm=speed)),
    )


def _over_speed(id: str, result: DeltaResult, identified: DeltaResult) -> Table:
    columns, cells = [Column("speed", "rpm", ".0f")], []
    words: tuple[tuple[Quantity, str], ...] = (
        ("charge", "charge"),
        ("loss", "loss"),
        ("charge_by_duration", "charge by duration"),
    )
    for quantity, word in words:
        for what, part in (("as identified", identified), ("any case", result)):
            envelope = part.over_speed()[quantity]
            for statistic, end in (("min", "lowest"), ("max", "highest")):
                columns.append(Column(f"{word} {what}: {end}", "%", "+.1f"))
                cells.append(100.0 * envelope.sel(statistic=statistic).to_numpy())
    speeds = result.dataset["speed"].to_numpy()
    rows: list[list[Cell]] = [
        [float(speed), *(float(cell[k]) for cell in cells)] for k, speed in enumerate(speeds)
    ]
    return Table(
        f"{id}-over-speed",
        Text(
            "{name}: change of charge, loss and sensitivity of the charge to duration, over all "
            "feasible lifts and durations at a speed.",
            name=_capital(result.name),
        ),
        columns,
        rows,
    )


def _parameters() -> Text:
    return Text(
        "The parameters of the engine stand at their bounds one at a time; then all at once, at "
        "the worst corner of their box where the sum of the single changes is largest. That place "
        "is a linear guess, and the corner is simulated: its change is a true one, but not proven "
        "to be the worst. Flow "
        "factor and duration offset of one cylinder are told for that cylinder. The sensors "
        "change what the controller believes: a MAF gain error the indicated charge, a MAP offset "
        "the charge and loss that a model computes from the wrong pressure."
    )


def _worst(deltas: AllDeltas) -> Table:
    rows: list[list[Cell]] = []
    for name, result in _named(deltas).items():
        for quantity in ("charge", "loss"):
            worst = result.worst(quantity)
            rows.append(
                [
                    name,
                    quantity,
                    100.0 * result.lowest(quantity).value,
                    100.0 * result.highest(quantity).value,
                    str(worst.at),
                    worst.case,
                ]
            )
    return Table(
        "worst",
        Text("Lowest and highest change by each delta, and where and in which case it is worst."),
        [
            Column("delta"),
            Column("of"),
            Column("lowest", "%", "+.1f"),
            Column("highest", "%", "+.1f"),
            Column("worst at"),
            Column("case"),
        ],
        rows,
    )


def _sensitivities(deltas: AllDeltas) -> Table:
    words = {q: q.replace("_", " ") for q in _SENSITIVITIES}
    rows: list[list[Cell]] = [
        [
            name,
            *(
                100.0 * end(quantity).value
                for quantity in _SENSITIVITIES
                for end in (result.lowest, result.highest)
            ),
        ]
        for name, result in _named(deltas).items()
    ]
    return Table(
        "sensitivities",
        Text(
            "Lowest and highest change of the sensitivities. Beyond \N{MINUS SIGN}100 % the sign "
            "of a sensitivity turns; several hundred per cent are found where the nominal one is "
            "no larger than the floor."
        ),
        [
            Column("delta"),
            *(
                Column(f"{words[quantity]}: {end}", "%", "+.0f")
                for quantity in _SENSITIVITIES
                for end in ("lowest", "highest")
            ),
        ],
        rows,
    )


def _together(deltas: AllDeltas) -> Text:
    charge, loss = (deltas.joint.interaction(quantity) for quantity in ("charge", "loss"))
    return Text(
        "The sum adds up the envelopes of the deltas point by point, which is exact to first "
        "order. The joint delta simulates the worst cases of all of them on one full plant. Both "
        "are relative to {against}, at every second speed and duration of the grid. The sum "
        "misses the joint change of the charge by up to {interaction_charge_worst:+.1f} (at "
        "{where}), and that of the loss by up to {interaction_loss_worst:+.1f} (at {where_loss}): "
        "joint less sum, for the same cases.",
        against=deltas.joint.against,
        where=str(charge.at),
        where_loss=str(loss.at),
        interaction_charge_worst=_percent(charge.value),
        interaction_loss_worst=_percent(loss.value),
    )


def _interaction(deltas: AllDeltas) -> Table:
    joint = deltas.joint
    columns, cells = [Column("speed", "rpm", ".0f")], []
    for quantity in ("charge", "loss"):
        for what, result in (("sum", deltas.total), ("joint", joint)):
            envelope = result.over_speed()[quantity]
            for statistic, end in (("min", "lowest"), ("max", "highest")):
                columns.append(Column(f"{quantity}, {what}: {end}", "%", "+.1f"))
                cells.append(envelope.sel(statistic=statistic).to_numpy())
        between = joint.dataset[f"interaction_{quantity}"]
        for end, over in (("lowest", between.min), ("highest", between.max)):
            columns.append(Column(f"{quantity}, joint less sum: {end}", "%", "+.1f"))
            cells.append(over(("case", "lift", "duration")).to_numpy())
    speeds = joint.dataset["speed"].to_numpy()
    return Table(
        "interaction",
        Text(
            "Sum of the envelopes against joint cases, and what the sum leaves out in the same "
            "cases, over all feasible lifts and durations at a speed."
        ),
        columns,
        [
            [float(speed), *(100.0 * float(cell[k]) for cell in cells)]
            for k, speed in enumerate(speeds)
        ],
    )


def _sensors() -> Text:
    return Text(
        "Lag and delay of the MAF sensor change no steady mean, but what is left of an imbalance "
        "between the cylinders when the reading is averaged over each event. Mode 1 repeats once "
        "a cycle; the highest mode alternates from event to event. A phase change of 180° turns "
        "the sign of what a balancing loop sees."
    )


def _modes(context: Context) -> Table:
    n, delta = context.engine.n_cylinders, SensorDelta()
    rows: list[list[Cell]] = []
    for speed in _SPEEDS_RPM:
        data = delta.mode_changes(speed, n).dataset
        for q in data["mode"].to_numpy().tolist()[1:]:
            mode = data.sel(mode=q)
            row: list[Cell] = [speed, int(q), float(mode["nominal_gain"])]
            for cause in ("lag", "delay"):
                part = mode.sel(case=[f"{cause} low", f"{cause} high"])
                row += [float(v) for v in part["gain_ratio"]]
                row += [float(v) + 0.0 for v in part["phase_change_deg"].round(6)]
            rows.append(row)
    causes = [
        Column(f"{cause} {end}: {what}", unit, spec)
        for cause in ("lag", "delay")
        for what, unit, spec in (("gain ratio", "1", ".2f"), ("phase change", "°", "+.0f"))
        for end in ("low", "high")
    ]
    return Table(
        "modes",
        Text(
            "Gain of each mode through event averages with the nominal MAF sensor, and what a "
            "true lag or delay at its bounds makes of gain and phase."
        ),
        [
            Column("speed", "rpm", ".0f"),
            Column("mode", "", ".0f"),
            Column("nominal gain", "1", ".3f"),
            *causes,
        ],
        rows,
    )


def _named(deltas: AllDeltas) -> dict[str, DeltaResult]:
    names = [*(_capital(result.name) for result in deltas.results), "Sum", "All at once"]
    return dict(zip(names, deltas, strict=True))


def _size(result: DeltaResult, quantity: Quantity) -> Number:
    return _percent(abs(result.worst(quantity).value))


def _percent(value: float) -> Number:
    return Number(100.0 * value, "%")


def _capital(name: str) -> str:
    return name[0].upper() + name[1:]
