"""Fit of engine parameters to measured charge, loss and pressure by least squares."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ._checks import in_range, one_of
from ._engine_fields import engine_fields, field_unit, get_field, replace_engine_fields
from .errors import ConvergenceError, InfeasibleProfileError, ParameterError, SimulationError
from .identification_result import FreeParameter, IdentificationResult
from .kinematics import FloatArray
from .observations import Experiment, Observation
from .parameters import Engine
from .valve import OnInfeasible

if TYPE_CHECKING:
    from .cycle import Cycle

# Relative step of the central differences. The plant is smooth to about 1e-10 of its results,
# so that the slope is good to about 1e-6.
DIFFERENCE_STEP = 1e-4
BOUND_RATIO = 10.0  # 1, default bounds around the initial value
LEAST_EFFECT = 1e-5  # 1, relative change of any value when a parameter changes by its own size
LEAST_INDEPENDENCE = 1e-5  # 1, smallest singular value of the Jacobian with unit columns
MOST_STEPS = 200

_LARGEST_SHARE = 1.0 - 1e-9  # 1, for fields that must stay below 1
_HIGHEST = {
    "valvetrain.roundness": _LARGEST_SHARE,
    "valvetrain.oscillation_amplitude": 1.0,
    "valvetrain.oscillation_decay_ratio": 1.0,
    "helmholtz.low_speed_damping": _LARGEST_SHARE,
    "helmholtz.high_speed_damping": _LARGEST_SHARE,
    "throttle.wide_open_deg": 90.0,
}

TIED = (
    FreeParameter(
        "valvetrain.slope_mm_s",
        ("valvetrain.opening_slope_mm_s", "valvetrain.closing_slope_mm_s"),
    ),
    FreeParameter(
        "helmholtz.frequency_hz",
        ("helmholtz.low_speed_frequency_hz", "helmholtz.high_speed_frequency_hz"),
    ),
    FreeParameter(
        "helmholtz.damping", ("helmholtz.low_speed_damping", "helmholtz.high_speed_damping")
    ),
)
"""Parameters that can be named although the engine holds them as two fields."""

ProgressCallback = Callable[[int, float], None]


def identify(
    engine: Engine,
    observations: Sequence[Observation],
    parameters: Sequence[str | FreeParameter],
    *,
    initial: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    confidence: float = 0.95,
    progress: ProgressCallback | None = None,
) -> IdentificationResult:
    """Fit parameters of an engine to observations by weighted least squares.

    Parameters
    ----------
    engine : Engine
        All that is not fitted, and where the fit starts.
    observations : sequence of Observation
        `ChargeObservation` and `TraceObservation`, mixed at will. Each value weighs by the
        standard error that its observation states; only the ratios matter, because the
        scatter of the residuals sets the scale.
    parameters : sequence of str or FreeParameter
        Fields of the engine (`engine_fields` lists them), the names of `TIED`, or any
        `FreeParameter`.
    initial : mapping, optional
        Where to start, by name; at the engine's own value (that of the first field) by default.
    bounds : mapping, optional
        Lowest and highest value, by name; a tenth and ten times the initial value by default,
        but no higher than the field allows.
    confidence : float
        Confidence of the intervals.
    progress : callable, optional
        Called after each simulated engine with their number and the rms of the residuals.

    Raises
    ------
    ParameterError
        If a name is unknown, a cylinder does not exist, there are not more values than
        parameters, or the values do not determine the parameters.
    ConvergenceError
        If the fit does not settle.
    InfeasibleProfileError
        If it settles where a valve cannot reach its lift.

    Notes
    -----
    At a given pressure the charge goes as 1/T, and the orifice of Eq. 13-14 passes a flow that
    does not depend on T: so the temperature is told apart from the flow coefficient where the
    valve restricts the flow in some of the observations and not in others. It is the
    temperature of the air in Eq. 1 and 2, not one that a sensor would read. The nine figures
    of Part I determine it to 0.8 % (95 %) and the slope of the valves to 30 % only.
    ``gas_constant`` and ``temperature`` enter Eq. 1 to 8 as a product: fit one of them.
    """
    from scipy.optimize import least_squares

    if not isinstance(engine, Engine):
        raise ParameterError(f"engine is {engine!r}, but must be an Engine")
    free = _free_parameters(engine, parameters)
    problem = _Problem(engine, _checked(engine, observations), free, progress)
    count = problem.measured.size
    if count <= len(free):
        raise ParameterError(
            f"{len(free)} parameters cannot be fitted to {count} values, at least {len(free) + 1} "
            "are needed: give more observations or fit less"
        )
    in_range("confidence", confidence, 0.0, 1.0, "1", open_low=True, open_high=True)
    start, low, high = _start_and_bounds(engine, free, initial or {}, bounds or {})
    scale = np.where(start != 0.0, np.abs(start), high - low)

    def residuals(x: FloatArray) -> FloatArray:
        return problem.residuals(x * scale)

    fit = least_squares(
        residuals,
        start / scale,
        jac="3-point",
        bounds=(low / scale, high / scale),
        x_scale="jac",
        diff_step=np.full(len(free), DIFFERENCE_STEP),
        ftol=1e-10,
        xtol=1e-10,
        gtol=1e-12,
        max_nfev=MOST_STEPS,
    )
    if not fit.success:
        raise ConvergenceError(
            f"the fit did not settle in {MOST_STEPS} steps: {fit.message} Start nearer, or "
            "narrow the bounds"
        )
    values = fit.x * scale
    fitted = problem.engine(values)
    try:
        modelled = problem.model(fitted, "raise")
    except InfeasibleProfileError as error:
        raise InfeasibleProfileError(
            f"the fit settles where a valve cannot reach its lift ({problem.describe(values)}): "
            f"{error}",
            error.highest_lift_mm,
        ) from error
    effect = np.asarray(fit.jac) * (problem.standard_error / problem.measured)[:, None]
    _check_effect(effect, free)
    covariance = _covariance(np.asarray(fit.jac), fit.fun, free)
    return IdentificationResult(
        engine=fitted,
        parameters=free,
        values=dict(zip((f.name for f in free), values.tolist(), strict=True)),
        covariance=covariance * np.outer(scale, scale),
        confidence=float(confidence),
        observations=problem.observations,
        modelled=modelled,
        at_bound=tuple(f.name for f, on in zip(free, fit.active_mask, strict=True) if on),
        evaluations=problem.evaluations,
    )


class _Problem:
    """Residuals of the observations as a function of the free parameters."""

    def __init__(
        self,
        base: Engine,
        observations: tuple[Observation, ...],
        free: tuple[FreeParameter, ...],
        progress: ProgressCallback | None,
    ) -> None:
        self.base = base
        self.observations = observations
        self.free = free
        self.progress = progress
        self.measured = np.concatenate([o.measured for o in observations])
        self.standard_error = np.concatenate([o.standard_error for o in observations])
        self.evaluations = 0

    def engine(self, values: FloatArray) -> Engine:
        return replace_engine_fields(
            self.base,
            {
                name: float(value)
                for f, value in zip(self.free, values, strict=True)
                for name in f.fields
            },
        )

    def model(self, engine: Engine, on_infeasible: OnInfeasible) -> tuple[FloatArray, ...]:
        cycles: dict[Experiment, Cycle] = {}
        for o in self.observations:
            if o.experiment not in cycles:
                cycles[o.experiment] = o.experiment.simulate(engine, on_infeasible)
        self.evaluations += 1
        return tuple(o.predict(cycles[o.experiment]) for o in self.observations)

    def residuals(self, values: FloatArray) -> FloatArray:
        # On its way the fit may pass where a valve cannot reach its lift; not at its end.
        try:
            modelled = np.concatenate(self.model(self.engine(values), "limit"))
        except SimulationError as error:
            error.add_note(f"met by the fit at {self.describe(values)}: narrow the bounds")
            raise
        residuals = (modelled - self.measured) / self.standard_error
        if self.progress is not None:
            self.progress(self.evaluations, math.sqrt(float(np.mean(residuals**2))))
        return residuals

    def describe(self, values: FloatArray) -> str:
        return ", ".join(f"{f.name} = {v:g}" for f, v in zip(self.free, values, strict=True))


def _free_parameters(
    engine: Engine, parameters: Sequence[str | FreeParameter]
) -> tuple[FreeParameter, ...]:
    """Resolve names, and check that no field is fitted twice."""
    if isinstance(parameters, str) or not parameters:
        raise ParameterError(
            f"parameters is {parameters!r}, but must be a sequence of at least one name"
        )
    tied = {f.name: f for f in TIED}
    free = []
    for p in parameters:
        if isinstance(p, FreeParameter):
            for name in p.fields:
                get_field(engine, name)
            free.append(p)
        else:
            one_of("parameter", p, (*engine_fields(engine), *tied))
            free.append(tied.get(p, FreeParameter(p, (p,))))
    for what, used in (
        ("field", [name for f in free for name in f.fields]),
        ("parameter", [f.name for f in free]),
    ):
        twice = [name for name in used if used.count(name) > 1]
        if twice:
            raise ParameterError(f"{what} {twice[0]!r} is fitted twice: name it once")
    return tuple(free)


def _checked(engine: Engine, observations: Sequence[Observation]) -> tuple[Observation, ...]:
    observations = tuple(observations)
    if not observations:
        raise ParameterError("there is no observation: give at least one")
    for i, o in enumerate(observations):
        if not 1 <= o.cylinder <= engine.n_cylinders:
            raise ParameterError(
                f"observation {i} is of cylinder {o.cylinder}, but the engine has cylinders 1 to "
                f"{engine.n_cylinders}"
            )
    return observations


def _start_and_bounds(
    engine: Engine,
    free: tuple[FreeParameter, ...],
    initial: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
) -> tuple[FloatArray, FloatArray, FloatArray]:
    names = tuple(f.name for f in free)
    for name in (*initial, *bounds):
        one_of("parameter of initial or bounds", name, names)
    rows = []
    for f in free:
        start = float(initial.get(f.name, get_field(engine, f.fields[0])))
        in_range(f"initial {f.name}", start, -math.inf, math.inf, field_unit(f.fields[0]))
        if f.name in bounds:
            low, high = (float(b) for b in bounds[f.name])
        elif start == 0.0:
            raise ParameterError(f"{f.name} starts at 0 and has no bounds: give bounds for it")
        else:
            low, high = sorted((start / BOUND_RATIO, start * BOUND_RATIO))
            high = min(high, *(_HIGHEST.get(name, high) for name in f.fields))
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ParameterError(
                f"bounds of {f.name} are {low:g} and {high:g}, but must be finite and in order"
            )
        in_range(f"initial {f.name}", start, low, high, field_unit(f.fields[0]))
        rows.append((start, low, high))
    start_, low_, high_ = np.array(rows).T
    return start_, low_, high_


def _check_effect(effect: FloatArray, free: tuple[FreeParameter, ...]) -> None:
    """Check that each scaled parameter changes some value, relative to that value."""
    for f, column in zip(free, effect.T, strict=True):
        if np.max(np.abs(column)) < LEAST_EFFECT:
            raise ParameterError(
                f"the observations do not depend on {f.name}: observe where it matters, or leave "
                "it out"
            )


def _covariance(
    jacobian: FloatArray, residuals: FloatArray, free: tuple[FreeParameter, ...]
) -> FloatArray:
    """Covariance of the scaled parameters, after checking that the data tell them apart."""
    lengths = np.linalg.norm(jacobian, axis=0)
    _, singular, rows = np.linalg.svd(jacobian / lengths, full_matrices=False)
    if singular[-1] < LEAST_INDEPENDENCE:
        mixed = [f.name for f, share in zip(free, np.abs(rows[-1]), strict=True) if share > 0.1]
        raise ParameterError(
            f"the observations do not tell {' and '.join(mixed)} apart: fit one of them, or "
            "observe where they act differently"
        )
    variance = float(residuals @ residuals) / (residuals.size - len(free))
    inverse = (rows.T / singular**2) @ rows
    return variance * inverse / np.outer(lengths, lengths)
