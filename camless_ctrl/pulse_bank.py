"""Sums of pulse responses, and one small state space for several of them.

All pulse responses of one event time read the same shift register of past charges; only their
tails, one a sensor lag, are states of their own.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError, PulseResponse
from plant.air_path import ComplexArray
from plant.kinematics import FloatArray

if TYPE_CHECKING:
    import control


@dataclass(frozen=True)
class PulseSum:
    """Linear combination of pulse responses of one event time.

    Parameters
    ----------
    terms : tuple of (float, PulseResponse)
        Factors and responses; at least one.
    """

    terms: tuple[tuple[float, PulseResponse], ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", tuple(self.terms))
        if not self.terms:
            raise ParameterError("the sum has no term: give one pulse response or more")
        _one_event_time(response for _, response in self.terms)

    @property
    def event_time(self) -> float:
        """Event time, s."""
        return self.terms[0][1].event_time

    def __call__(self, z: ArrayLike) -> ComplexArray:
        """Return the complex response at points `z` (per event), of the shape of `z`."""
        return np.asarray(sum(factor * response(z) for factor, response in self.terms))

    def __add__(self, other: PulseSum) -> PulseSum:
        """Return the sum of both."""
        return PulseSum((*self.terms, *other.terms))

    def scaled(self, factor: float) -> PulseSum:
        """Return the sum times a factor."""
        return PulseSum(tuple((factor * weight, response) for weight, response in self.terms))


def pulse_bank(
    sums: Sequence[PulseSum], latency: int, *, input: str, outputs: Sequence[str], name: str
) -> control.StateSpace:
    """Return ``z^-latency`` times several sums as one system per event.

    Parameters
    ----------
    sums : sequence of PulseSum
        One for each output; of one event time.
    latency : int
        Events of delay; as many as the earliest tap needs, and one more.
    input : str
        Name of the input.
    outputs : sequence of str
        Names of the outputs.
    name : str
        Name of the system.

    Raises
    ------
    ParameterError
        If an output would need the present or a later charge, the sums are of several event times,
        or their number is not that of the outputs.
    """
    import control

    if len(sums) != len(outputs) or not sums:
        raise ParameterError(
            f"there are {len(sums)} sums for {len(outputs)} outputs: give one sum for each output, "
            "at least one"
        )
    _one_event_time(r for s in sums for _, r in s.terms)
    terms = [(k, factor, r) for k, s in enumerate(sums) for factor, r in s.terms]
    earliest = min(r.first for _, _, r in terms) + latency
    if earliest < 1:
        raise ParameterError(
            f"latency is {latency} events, but must be at least {latency + 1 - earliest}: the "
            "window of the estimate has not ended yet"
        )
    # Lag of the last tap, at which the tail starts, and its pole.
    tails = sorted({(latency + r.first + r.taps.size - 1, r.pole) for _, _, r in terms})
    m = max(lag for lag, _ in tails)
    A = np.zeros((m + len(tails), m + len(tails)))
    A[np.arange(1, m), np.arange(m - 1)] = 1.0  # shift register of past charges
    for j, (lag, pole) in enumerate(tails):
        A[m + j, lag - 1], A[m + j, m + j] = 1.0, pole
    B = np.zeros((len(A), 1))
    B[0, 0] = 1.0
    C: FloatArray = np.zeros((len(sums), len(A)))
    for k, factor, r in terms:
        start = latency + r.first
        C[k, start - 1 : start - 1 + r.taps.size] += factor * r.taps
        j = tails.index((start + r.taps.size - 1, r.pole))
        C[k, m + j] += factor * r.taps[-1] * r.pole
    return control.ss(
        A,
        B,
        C,
        np.zeros((len(sums), 1)),
        sums[0].event_time,
        inputs=[input],
        outputs=list(outputs),
        states=[f"charge_{i + 1}_events_ago" for i in range(m)]
        + [f"maf_tail_{j + 1}" for j in range(len(tails))],
        name=name,
    )


def _one_event_time(responses: Iterable[PulseResponse]) -> None:
    """Raise if responses have several event times."""
    times = sorted({response.event_time for response in responses})
    if len(times) > 1:
        raise ParameterError(
            f"the responses have event times {times} s, but must have one: take them at one speed"
        )
