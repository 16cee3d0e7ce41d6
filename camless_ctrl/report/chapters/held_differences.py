"""Part of a chapter: the simple loop at the speeds at which it holds differences of cylinders."""

from __future__ import annotations

import math

from camless_ctrl.adaptation import AdaptationGains
from camless_ctrl.confirmation import GrowthCheck, check_growth
from camless_ctrl.robustness import RobustnessResult, analyse_point

from ..chapter import Context
from ..content import Column, Number, Table, Text
from .maps import mean_value_plant

DELAY_STEP = 0.5e-3  # s, either side of a predicted limit
TRIAL_GAIN = 0.08  # per cycle, with which a held imbalance is tried


def try_held(results: list[RobustnessResult]) -> list[RobustnessResult]:
    """Analyse the speeds at which imbalance is held as if it were adapted."""
    return [
        analyse_point(
            r.local,
            r.demand,
            r.estimator,
            AdaptationGains(r.gains.mean, TRIAL_GAIN),
            r.sensitivity_error,
        )
        for r in results
        if r.gains.imbalance == 0.0
    ]


def grow_beyond(context: Context, trials: list[RobustnessResult]) -> list[GrowthCheck]:
    """Grow the alternating mode on the full plant on both sides of the predicted limit."""
    return [
        check_growth(
            r,
            mean_value_plant(context),
            r.delay_limit_mode,
            delay=r.delay_limit + beyond,
            engine=context.engine,
        )
        for r in trials
        if math.isfinite(r.delay_limit)
        for beyond in (-DELAY_STEP, DELAY_STEP)
    ]


def held_texts(trials: list[RobustnessResult]) -> list[Text]:
    """Return why the differences are held, a text a speed."""
    return [
        Text(
            "At {speed:.0f} the differences between cylinders are held as learnt, not adapted: "
            "adapted with a gain of {gain:.2f} per cycle they would reach a spectral radius of "
            "{radius:.3f} at a lag of {lag:.0f} and a delay of {delay:.1f}, because the delay "
            "turns the sign of the alternating mode and a smaller gain only slows its growth.",
            speed=Number(r.speed_rpm, "rpm"),
            gain=Number(TRIAL_GAIN),
            radius=Number(r.worst[0]),
            lag=Number(1e3 * r.worst[1], "ms"),
            delay=Number(1e3 * r.worst[2], "ms"),
        )
        for r in trials
        if not r.withstands_sensor
    ]


def growth_table(checks: list[GrowthCheck]) -> list[Table]:
    """Return growth on the full plant on both sides of the limit; nothing without runs."""
    if not checks:
        return []
    return [
        Table(
            "growth",
            Text(
                "Beyond the verdict: were imbalance adapted at the speeds at which it is held, a "
                "small disturbance of its mode on both sides of the predicted delay limit, as "
                "predicted and on the full plant."
            ),
            [
                Column("speed", "rpm", ".0f"),
                Column("mode"),
                Column("delay", "ms", ".2f"),
                Column("predicted factor", "per cycle", ".4f"),
                Column("simulated factor", "per cycle", ".4f"),
                Column("outcome", words=("dies out", "diverges")),
                Column("prediction", words=("agrees", "disagrees")),
            ],
            [
                [
                    check.speed_rpm,
                    f"q={check.q}",
                    1e3 * check.delay,
                    check.predicted,
                    check.simulated,
                    check.simulated < 1.0,
                    check.agrees,
                ]
                for check in checks
            ],
        )
    ]
