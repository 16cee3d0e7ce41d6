"""The air-charge loop in the event domain, as it is and lifted over a cycle.

One intake event takes ``T = 120/(n N)`` s, and charges are relative to demand. The loop goes
from the true charge through its estimate (`MeasurementResponse`) to the adaptation, which
integrates per cylinder.

For equal cylinders the loop repeats every event; lifted over a cycle it is an n x n system
whose transfer matrix at ``zeta = z^n`` has the eigenvalues ``L(z)`` at the n roots ``z``: mode
q (imbalance q times a cycle; q = 0 is the mean) at ``z = zeta^(1/n) exp(j 2 pi q/n)``. The
eigenvectors are orthogonal on the unit circle, so that the largest singular value over all
cylinders is the largest gain over the modes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from plant._checks import in_range, whole
from plant._lifting import lifted
from plant.kinematics import FloatArray

from .adaptation import AdaptationGains
from .estimator import ChargeEstimator
from .measurement_response import ComplexArray, FlowShape, MeasurementResponse, event_time

if TYPE_CHECKING:
    import control

# Half the width of a mode on the circle, in distances between modes. It is a little more than
# a half: what happens at the border of two modes concerns both.
MODE_WIDTH = 0.575


@dataclass(frozen=True)
class ModeLoop:
    """Loop of one circulant mode.

    Attributes
    ----------
    q : int
        Mode: 0 the mean, q an imbalance q times a cycle; stands for ``n - q`` as well.
    loop : EventLoop
        The loop that it is a part of.
    poles : ndarray
        Closed-loop poles per event that belong to the mode.
    """

    q: int
    loop: EventLoop = field(repr=False)
    poles: ComplexArray = field(repr=False)

    def __call__(self, theta: ArrayLike) -> ComplexArray:
        """Loop response at cycle phases `theta` in rad per cycle, in ``[-pi, pi]``."""
        angle = (np.asarray(theta, dtype=float) + 2.0 * np.pi * self.q) / self.loop.n_cylinders
        return self.loop(np.exp(1j * angle))

    @property
    def stable(self) -> bool:
        """Whether all poles of the mode lie inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1.0))

    @property
    def spectral_radius(self) -> float:
        """Largest pole radius per cycle."""
        radius = float(np.max(np.abs(self.poles), initial=0.0))
        return radius**self.loop.n_cylinders


@dataclass(frozen=True)
class EventLoop:
    """Adaptive air-charge loop of equal cylinders at one speed.

    The loop response goes from a relative charge error to the correction that it causes. The
    correction of event k rests on estimates of events up to ``k - latency``.

    Parameters
    ----------
    n_cylinders : int
        Number of cylinders.
    measurement : MeasurementResponse
        From true to estimated charge.
    gains : AdaptationGains
        Gains per cycle of the mean and of the imbalance modes.
    latency : int
        Events from the IVO of an event to the first IVO at which its estimate is used.
    sensitivity : float
        True over assumed sensitivity of the charge to the command, 1.
    """

    n_cylinders: int
    measurement: MeasurementResponse
    gains: AdaptationGains
    latency: int
    sensitivity: float = 1.0

    def __post_init__(self) -> None:
        whole("n_cylinders", self.n_cylinders, 1, 24)
        whole("latency", self.latency, 1, 100)
        in_range("sensitivity", self.sensitivity, -100.0, 100.0, "1")

    @classmethod
    def at_speed(
        cls,
        speed_rpm: float,
        estimator: ChargeEstimator,
        gains: AdaptationGains,
        *,
        n_cylinders: int = 4,
        time_constant: float = 15e-3,
        delay: float = 1e-3,
        sensitivity: float = 1.0,
        shape: FlowShape | None = None,
    ) -> EventLoop:
        """Return the loop at a speed with a MAF sensor of given lag and delay (s)."""
        T = event_time(speed_rpm, n_cylinders)
        response = MeasurementResponse.of_maf(
            estimator, T, time_constant=time_constant, delay=delay, shape=shape
        )
        return cls(n_cylinders, response, gains, estimator.latency_events(T), sensitivity)

    def __call__(self, z: ArrayLike) -> ComplexArray:
        """Loop response at points `z` per event; infinite at the integrators."""
        z = np.asarray(z, dtype=complex)
        n, latency = self.n_cylinders, self.latency
        wait = -latency % n  # events from the first possible use to the cylinder's own next IVO
        with np.errstate(divide="ignore", invalid="ignore"):
            own = self.gains.imbalance * z**-wait / (1.0 - z**-n)
            shared = (self.gains.mean - self.gains.imbalance) / n / (1.0 - 1.0 / z)
            response = self.sensitivity * z**-latency * self.measurement(z) * (own + shared)
        return np.asarray(response, dtype=complex)

    def system(self) -> control.StateSpace:
        """Return the loop per event: input ``charge``, output ``correction``."""
        import control

        estimate = self.measurement.system(self.latency)
        A, B, C, D = _adaptation_matrices(self.n_cylinders, self.latency, self.gains)
        law = control.ss(
            A,
            B,
            self.sensitivity * C,
            self.sensitivity * D,
            self.measurement.event_time,
            inputs=["estimate"],
            outputs=["correction"],
            states=[f"factor_{i}_events_ahead" for i in range(len(A))],
            name="adaptation",
        )
        loop = control.interconnect(
            [estimate, law], inputs=["charge"], outputs=["correction"], name="event_loop"
        )
        return _as_state_space(loop)

    def lifted(self) -> control.StateSpace:
        """Return the loop lifted over a cycle: n charges in, n corrections out.

        Inputs ``charge[1]`` to ``charge[n]``, outputs ``correction[1]`` to ``correction[n]``,
        sampling time one cycle. The adaptation is built cylinder by cylinder, without use of
        `system`.
        """
        import control

        n = self.n_cylinders
        cycle_time = n * self.measurement.event_time
        estimate = control.ss(
            *lift(self.measurement.system(self.latency), n),
            cycle_time,
            inputs=[f"charge[{i + 1}]" for i in range(n)],
            outputs=[f"estimate[{i + 1}]" for i in range(n)],
            name="measurement",
        )
        # One factor a cylinder. At event i the estimate of cylinder i - latency arrives.
        shared = (self.gains.mean - self.gains.imbalance) / n
        B, D = np.zeros((n, n)), np.zeros((n, n))
        for i in range(n):
            B[:, i] += shared
            B[(i - self.latency) % n, i] += self.gains.imbalance
            D[i] = B[i]  # what has arrived up to event i is in the correction of cylinder i
        A, C = np.eye(n), np.eye(n)
        if self.gains.imbalance == 0.0:  # differences are held: one factor moves for all
            A, B, C = np.eye(1), B[:1], np.ones((n, 1))
        law = control.ss(
            A,
            B,
            self.sensitivity * C,
            self.sensitivity * D,
            cycle_time,
            inputs=[f"estimate[{i + 1}]" for i in range(n)],
            outputs=[f"correction[{i + 1}]" for i in range(n)],
            states=[f"factor[{i + 1}]" for i in range(len(A))],
            name="adaptation",
        )
        loop = control.interconnect(
            [estimate, law],
            inputs=[f"charge[{i + 1}]" for i in range(n)],
            outputs=[f"correction[{i + 1}]" for i in range(n)],
            name="lifted_loop",
        )
        return _as_state_space(loop)

    def closed_loop(self) -> control.StateSpace:
        """Return the lifted closed loop, from charge disturbances to charges (sensitivity)."""
        import control

        n = self.n_cylinders
        loop = self.lifted()
        identity = control.ss([], [], [], np.eye(n), loop.dt)
        closed = control.feedback(identity, loop)
        closed.set_inputs([f"disturbance[{i + 1}]" for i in range(n)])
        closed.set_outputs([f"charge[{i + 1}]" for i in range(n)])
        return closed

    def poles(self) -> ComplexArray:
        """Closed-loop poles per event; their n-th powers are those of the lifted loop."""
        A, B, C = self.measurement.matrices(self.latency)
        law_A, law_B, law_C, law_D = _adaptation_matrices(
            self.n_cylinders, self.latency, self.gains
        )
        k = self.sensitivity
        closed = np.block([[A - k * B @ law_D @ C, -k * B @ law_C], [law_B @ C, law_A]])
        return np.linalg.eigvals(closed)

    def modes(self) -> tuple[ModeLoop, ...]:
        """Return the modes ``q = 0 ... n/2``, each with the closed-loop poles around it.

        Poles near the border of two modes belong to both, see `MODE_WIDTH`.
        """
        n = self.n_cylinders
        poles = self.poles()
        turn = np.abs(np.angle(poles)) * n / (2.0 * np.pi)  # 0 to n/2; conjugates together
        return tuple(
            ModeLoop(q, self, poles[np.abs(turn - q) <= MODE_WIDTH]) for q in range(n // 2 + 1)
        )


def lift(
    system: control.StateSpace, n: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Matrices ``A, B, C, D`` of a single-input single-output system lifted over `n` samples."""
    A, B, C, D = (np.asarray(m, dtype=float) for m in (system.A, system.B, system.C, system.D))
    return lifted([(A, B, C, D)] * n)


def _adaptation_matrices(
    n: int, latency: int, gains: AdaptationGains
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Adaptation per event: state i is the factor of the cylinder that opens i events ahead.

    Without imbalance gain the differences between factors are held, outside the loop, and one
    factor common to all is left.
    """
    if gains.imbalance == 0.0:
        shared = np.full((1, 1), gains.mean / n)
        return np.eye(1), shared, np.eye(1), shared
    gain = np.full(n, (gains.mean - gains.imbalance) / n)
    gain[-latency % n] += gains.imbalance  # cylinder of the estimate that arrives
    A = np.roll(np.eye(n), 1, axis=1)  # state i becomes state i - 1
    return A, (A @ gain)[:, None], np.eye(1, n), gain[None, :1]


def _as_state_space(system: control.StateSpace) -> control.StateSpace:
    """Return the plain state space of an interconnection, its names kept."""
    import control

    return control.ss(
        system.A,
        system.B,
        system.C,
        system.D,
        system.dt,
        inputs=system.input_labels,
        outputs=system.output_labels,
        states=system.state_labels,
        name=system.name,
    )
