"""H-infinity synthesis of a python-control system, checked before, stopped if need be, verified."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from plant._checks import in_range, whole
from plant.errors import ParameterError

from ._realisation import Realisation, axis_points, realisation_of
from ._solver import Solution, solve
from .checks import SynthesisCheck, check_realisation
from .stoppable import run_stoppable

if TYPE_CHECKING:
    import control
    from matplotlib.axes import Axes

_ENDLESS = (
    "the problem is ill-posed or badly scaled, so that the solver does not end; scale the "
    "signals to about 1, regularise with small weights, or give more time"
)


@dataclass(frozen=True)
class SynthesisResult:
    """Controller that was computed and verified.

    Attributes
    ----------
    controller : control.StateSpace
        From measurements to controls; ``u = K y``, no sign change.
    gamma : float
        H-infinity norm of `closed_loop`, computed apart from the solver.
    closed_loop : control.StateSpace
        From disturbances to errors, stable.
    check : SynthesisCheck
        Conditions that the plant was tested for.
    log : tuple of str
        What was tried, in order.
    smallest_gamma : float
        Smallest gamma at which a controller was found; `gamma` lies above it by the
        tolerance at most, unless the log tells of a wider back-off.
    seconds : float
        Time taken, the start of the process included, s.
    """

    controller: control.StateSpace
    gamma: float
    closed_loop: control.StateSpace
    check: SynthesisCheck = field(repr=False)
    log: tuple[str, ...] = field(repr=False)
    smallest_gamma: float
    seconds: float

    def __str__(self) -> str:
        """Return the result in one sentence."""
        return (
            f"controller of order {self.controller.nstates} with a verified closed-loop "
            f"H-infinity norm of {self.gamma:.4g} (smallest found {self.smallest_gamma:.4g}), "
            f"in {self.seconds:.2f} s"
        )

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the largest gain of the closed loop against frequency, with its norm."""
        import control

        from plant._plotting import COLOURS, axes, styled

        loop = realisation_of(self.closed_loop)
        discrete = bool(control.isdtime(self.closed_loop, strict=True))
        points = axis_points(loop, discrete, 600)
        points = points[1:] if discrete else points
        T = 1.0 if self.closed_loop.dt in (True, None) else float(self.closed_loop.dt)
        omega = np.angle(points) / T if discrete else points.imag
        with styled():
            ax = axes(ax)
            gain = np.linalg.norm(loop.response(points), 2, (1, 2))
            ax.semilogx(omega, gain, color=COLOURS[0], label="largest gain")
            ax.axhline(self.gamma, color=COLOURS[1], ls="--", label=f"norm {self.gamma:.3g}")
            ax.set_xlabel("frequency (rad/s)")
            ax.set_ylabel("closed-loop gain (1)")
            ax.set_ylim(0.0, 1.35 * self.gamma)
            ax.legend(loc="upper left", ncols=2)
        return ax


def hinf_synthesis(
    P: control.StateSpace | control.TransferFunction,
    n_meas: int,
    n_ctrl: int,
    *,
    timeout_s: float = 30.0,
    tolerance: float = 1e-3,
) -> SynthesisResult:
    """Compute the controller that all but minimises the closed-loop H-infinity norm.

    A discrete plant goes through the bilinear transform, which leaves the norm as it is.

    Parameters
    ----------
    P : control.StateSpace or control.TransferFunction
        Generalised plant; the last `n_meas` outputs go to the controller, the last `n_ctrl`
        inputs come from it.
    n_meas, n_ctrl : int
        Numbers of measurements and of controls.
    timeout_s : float
        Time limit, s.
    tolerance : float
        Relative distance to the least norm, 1; smaller values give faster poles and larger
        gains.

    Raises
    ------
    SynthesisError
        If the plant fails a condition, no controller is found or verified, or the time limit
        is reached.
    ParameterError
        If an argument has no meaning.

    Examples
    --------
    >>> import control
    >>> G = control.tf([200], [0.025, 1.0025, 10.1, 1])
    >>> W1 = control.tf([1 / 1.5, 10], [1, 1e-3])
    >>> from camless_ctrl.synthesis import mixed_sensitivity
    >>> result = hinf_synthesis(mixed_sensitivity(G, W1, 1.0, None), 1, 1)
    >>> round(result.gamma, 2)
    1.37
    """
    import control

    start = time.perf_counter()
    n_meas, n_ctrl = whole("n_meas", n_meas, 1, 1000), whole("n_ctrl", n_ctrl, 1, 1000)
    tolerance = in_range("tolerance", tolerance, 1e-8, 0.5, "1")
    plant = state_space(P)
    discrete = bool(control.isdtime(plant, strict=True))
    matrices = realisation_of(plant)
    check = check_realisation(
        matrices, n_meas, n_ctrl, discrete, plant.input_labels, plant.output_labels
    )
    check.require()
    solution = solved(matrices, n_meas, n_ctrl, discrete, tolerance, timeout_s)
    return SynthesisResult(
        controller_of(solution.controller, plant, n_meas, n_ctrl),
        solution.norm,
        closed_loop_of(solution.closed_loop, plant, n_meas, n_ctrl),
        check,
        solution.log,
        solution.smallest,
        time.perf_counter() - start,
    )


def solved(
    P: Realisation,
    n_meas: int,
    n_ctrl: int,
    discrete: bool,
    tolerance: float,
    timeout_s: float,
) -> Solution:
    """Solution of a plant that has passed its check, from a stoppable process."""
    return run_stoppable(
        solve, (P, n_meas, n_ctrl, discrete, tolerance), timeout_s, likely_reason=_ENDLESS
    )


def state_space(P: control.lti.LTI, name: str = "the plant") -> control.StateSpace:
    """Return the state space of a system; refuse what has none."""
    import control

    if isinstance(P, control.TransferFunction):
        pairs = zip(np.ravel(P.num_array), np.ravel(P.den_array), strict=True)
        if any(len(np.trim_zeros(n, "f")) > len(np.trim_zeros(d, "f")) for n, d in pairs):
            raise ParameterError(
                f"{name} is improper (more zeros than poles): add fast poles, a decade or more "
                "above the bandwidth"
            )
    elif not isinstance(P, control.StateSpace):
        raise ParameterError(
            f"{name} is a {type(P).__name__}, but must be a StateSpace or a TransferFunction: "
            "convert it with control.ss"
        )
    return control.ss(P)


def controller_of(
    K: Realisation, plant: control.StateSpace, n_meas: int, n_ctrl: int
) -> control.StateSpace:
    """Controller as a system, with the plant's names of its signals and its sampling time."""
    import control

    inputs, outputs = plant.output_labels[-n_meas:], plant.input_labels[-n_ctrl:]
    return control.ss(*K, plant.dt, inputs=inputs, outputs=outputs, name="controller")


def closed_loop_of(
    loop: Realisation, plant: control.StateSpace, n_meas: int, n_ctrl: int
) -> control.StateSpace:
    """Closed loop as a system, with the plant's names of disturbances and errors."""
    import control

    inputs, outputs = plant.input_labels[:-n_ctrl], plant.output_labels[:-n_meas]
    return control.ss(*loop, plant.dt, inputs=inputs, outputs=outputs, name="closed_loop")
