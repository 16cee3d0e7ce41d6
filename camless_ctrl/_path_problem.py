"""The nonlinear programme of the optimal motion, in CasADi, and the proof of its solution."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from plant.kinematics import FloatArray

from .least_loss_motion import FeedforwardOptions, OptimalityCertificate, OptimalMotion

if TYPE_CHECKING:
    from plant import MeanValuePlant

_ACTIVE = 1e-6  # scaled slack below which an inequality binds
_INSIDE = 1e-4  # by which a start keeps off the bounds
_SETTINGS = (  # of IPOPT, tried in this order
    {"mu_init": 1e-4},
    {"mu_init": 1e-1},
    {"mu_init": 1e-6, "warm_start_init_point": "yes", "warm_start_bound_push": 1e-9},
)
_BOUNDS = (("lowest lift", "highest lift"), ("shortest duration", "longest map duration"))
_CONSTRAINTS = (("charge", "charge"), ("", "longest duration"), ("authority", ""), ("dwell", ""))


def ambient_charge(maps: MeanValuePlant) -> float:
    """Charge of the displaced volume at ambient density, kg."""
    e = maps.engine
    return e.ambient_pressure * e.displaced_volume / (e.gas_constant * e.temperature)


class MotionProblem:
    """Programme of one map and one set of options; solve it at any charge and speed.

    Variables are lift over the highest lift, and the share of the way from the shortest to the
    longest duration of the map, which makes a box of the feasible profiles.
    """

    def __init__(self, maps: MeanValuePlant, options: FeedforwardOptions) -> None:
        import casadi

        self.maps, self.options = maps, options
        self.longest = options.longest_deg(maps.engine, maps.region)
        top = options.highest_lift_mm
        lift, share = casadi.MX.sym("lift"), casadi.MX.sym("share")
        speed, demand, scale = (casadi.MX.sym(name) for name in ("speed", "demand", "scale"))
        x = casadi.vertcat(lift, share)
        p = casadi.vertcat(speed, demand, scale)
        values = maps.casadi_function(coordinates="share", outside="hold")(
            lift_mm=top * lift, share=share, speed_rpm=speed
        )
        charge, duration = values["air_charge"], values["duration_deg"]
        # At constant lift and speed the duration is linear in the share.
        slope = casadi.jacobian(charge, share) / casadi.jacobian(duration, share)
        cost = (values["pumping_loss"] + options.penalty(top * lift)) / scale
        # Dwell in deg: the way from the shortest duration, over the longest one.
        dwell = share * casadi.jacobian(duration, share) / self.longest
        g = casadi.vertcat(
            charge / demand - 1.0,
            duration / self.longest - 1.0,
            slope / (ambient_charge(maps) * options.least_authority),
            dwell,
        )
        self._programme = {"x": x, "p": p, "f": cost, "g": g}
        self._first_order = casadi.Function(
            "first_order",
            [x, p],
            [cost, g, casadi.gradient(cost, x), casadi.jacobian(g, x), duration],
        )
        self._solvers: dict[int, Any] = {}

    def solve(
        self, charge: float, speed_rpm: float, lift_mm: float, duration_deg: float
    ) -> OptimalMotion:
        """Minimum next to a start; if IPOPT misses it, it is tried again in other ways."""
        region, top = self.maps.region, self.options.highest_lift_mm
        share = float(region.share(lift_mm, duration_deg, speed_rpm).value)
        start = np.array([lift_mm / top, share])
        low_x, high_x = np.array([self.options.lowest_lift_mm / top, 0.0]), np.ones(2)
        start = np.clip(start, low_x + _INSIDE, high_x - _INSIDE)
        scale = float(self.maps.pumping_loss(lift_mm, duration_deg, speed_rpm))
        scale = abs(scale + float(self.options.penalty(lift_mm)))
        dwell = 6.0 * speed_rpm * self.options.least_dwell / self.longest
        low_g = np.array([0.0, -np.inf, 1.0, dwell if dwell > 0.0 else -np.inf])
        high_g = np.array([0.0, 0.0, np.inf, np.inf])
        numbers = [speed_rpm, charge, scale]
        tried = list[OptimalMotion]()
        for trial in range(len(_SETTINGS)):
            solver = self._solver(trial)
            found = solver(x0=start, p=numbers, lbx=low_x, ubx=high_x, lbg=low_g, ubg=high_g)
            motion = self._motion(
                charge, speed_rpm, numbers, found, solver.stats(), (low_x, high_x, low_g, high_g)
            )
            if motion.optimal:
                return motion
            tried.append(motion)
        return min(tried, key=_failure)

    def _solver(self, trial: int) -> Any:
        if trial not in self._solvers:
            import casadi

            settings: dict[str, Any] = {
                "print_time": False,
                "error_on_fail": False,  # the certificate tells
                "ipopt.print_level": 0,
                "ipopt.sb": "yes",
                "ipopt.tol": 1e-10,
                "ipopt.bound_relax_factor": 0.0,
                "ipopt.max_iter": 200,
            }
            settings |= {f"ipopt.{name}": value for name, value in _SETTINGS[trial].items()}
            self._solvers[trial] = casadi.nlpsol("motion", "ipopt", self._programme, settings)
        return self._solvers[trial]

    def _motion(
        self,
        charge: float,
        speed: float,
        numbers: list[float],
        found: dict[str, Any],
        stats: dict[str, Any],
        bounds: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    ) -> OptimalMotion:
        x, on_x, on_g = (_flat(found[name]) for name in ("x", "lam_x", "lam_g"))
        cost, g, slope, jacobian, duration = self._first_order(x, numbers)
        gradient = _flat(slope) + np.array(jacobian).T @ on_g + on_x
        value = np.concatenate((x, _flat(g)))
        low = np.concatenate((bounds[0], bounds[2]))
        high = np.concatenate((bounds[1], bounds[3]))
        multiplier = np.concatenate((on_x, on_g))
        equal = low == high
        violation = np.maximum(np.maximum(low - value, value - high), 0.0)
        # A positive multiplier belongs to the upper bound, a negative one to the lower.
        slack = np.where(multiplier > 0.0, high - value, value - low)
        product = np.abs(multiplier * np.where(np.isfinite(slack), slack, 1.0))
        multipliers, active = dict[str, float](), list[str]()
        for k, names in enumerate((*_BOUNDS, *_CONSTRAINTS)):
            for name, bound, sign in ((names[0], low[k], -1.0), (names[1], high[k], 1.0)):
                if not np.isfinite(bound) or not name:
                    continue
                if equal[k]:
                    multipliers[name] = float(multiplier[k])
                    continue
                binds = abs(value[k] - bound) <= _ACTIVE
                multipliers[name] = float(max(sign * multiplier[k], 0.0)) if binds else 0.0
                if binds:
                    active.append(name)
        lift = float(x[0]) * self.options.highest_lift_mm
        loss = float(cost) * numbers[2] - float(self.options.penalty(lift))
        certificate = OptimalityCertificate(
            gradient=float(np.abs(gradient).max()),
            violation=float(violation.max()),
            complementarity=float(np.where(equal, 0.0, product).max()),
            status=str(stats["return_status"]),
            iterations=int(stats["iter_count"]),
            multipliers=multipliers,
            active=tuple(active),
        )
        return OptimalMotion(
            charge=charge,
            speed_rpm=speed,
            lift_mm=lift,
            duration_deg=float(duration),
            loss=loss,
            cost=float(cost) * numbers[2],
            # The constraint is charge/demand = 1, so that its multiplier is per share of demand.
            marginal_cost=-multipliers["charge"] * numbers[2] / charge,
            certificate=certificate,
        )


@lru_cache(maxsize=4)
def motion_problem(maps: MeanValuePlant, options: FeedforwardOptions) -> MotionProblem:
    """Return the programme of a map, made once (it takes about two seconds)."""
    return MotionProblem(maps, options)


def _failure(motion: OptimalMotion) -> float:
    c = motion.certificate
    return max(c.gradient, c.violation, c.complementarity)


def _flat(value: Any) -> FloatArray:
    return np.asarray(value, dtype=float).ravel()
