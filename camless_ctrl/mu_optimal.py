"""The fastest synthesised law whose loop is robust: the LTI baseline of the adaptation laws."""

from __future__ import annotations

from .adaptation import AdaptationGains
from .gain_synthesis import design_gains
from .lti_synthesis import LtiLaw, dk_law, hinf_law
from .synthesis.errors import SynthesisError
from .uncertain_loop import SENSITIVITY_BOUND
from .uncertain_measurement import UncertainMeasurement

PACES = (1.0, 0.5, 0.25)  # times the designed gains, tried in turn until there is a law


def mu_optimal_law(
    measurement: UncertainMeasurement,
    paces: AdaptationGains | None = None,
    *,
    sensitivity_bound: float = SENSITIVITY_BOUND,
    timeout_s: float = 30.0,
    confirm: bool = True,
) -> LtiLaw:
    """Return the law of D-K iteration or of H-infinity synthesis that settles fastest.

    Both are judged by the mixed mu of the whole set, see `lti_synthesis`. A pace for which neither
    finds a law that is robust and stable by itself is given up for a slower one.

    Parameters
    ----------
    measurement : UncertainMeasurement
        Measurement at one speed.
    paces : AdaptationGains, optional
        What the performance weight asks for at first; the gains of `design_gains` if left out.
    sensitivity_bound : float
        Bound on ``|S|`` over the whole set.
    timeout_s : float
        Time limit of each synthesis, s.
    confirm : bool
        Whether to prove the result with `mu.robust_performance` (some seconds).

    Raises
    ------
    SynthesisError
        If neither synthesis finds a law at any pace.
    """
    if paces is None:
        paces = design_gains(measurement, sensitivity_bound=sensitivity_bound, confirm=False).gains
    failed: list[str] = []
    for scale in PACES:
        found: list[LtiLaw] = []
        for make in (dk_law, hinf_law):
            try:
                law = make(
                    measurement,
                    paces.scaled(scale),
                    sensitivity_bound=sensitivity_bound,
                    timeout_s=timeout_s,
                    confirm=confirm,
                )
            except SynthesisError as error:
                failed.append(str(error))
            else:
                found.append(law)
        if found:
            return min(found, key=_slowness)
    raise SynthesisError("no synthesis found a law: " + " | ".join(failed))


def _slowness(law: LtiLaw) -> float:
    """Settling time, summed over the modes, cycles."""
    return sum(law.settling_cycles)
