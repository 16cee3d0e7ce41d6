"""Linear members of the set of an uncertain loop: poles and sensitivity of thousands at once."""

from __future__ import annotations

import numpy as np

from plant.kinematics import FloatArray

from .uncertain_loop import UncertainLoop

_ANGLES = 721  # points between those of the modes, where an integrator is infinite
_ORDER = 3  # of the largest remainder


def random_all_passes(samples: int, random: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Numerators and denominators of systems of gain 1, in ``z^-1``, each (samples, 4)."""
    denominator = np.zeros((samples, _ORDER + 1))
    denominator[:, 0] = 1.0
    order = np.zeros(samples, dtype=int)
    kind = random.integers(0, 4, samples)  # constant, delay, one pole, two poles
    order[kind == 1] = random.integers(1, _ORDER + 1, int(np.count_nonzero(kind == 1)))
    one, two = kind == 2, kind == 3
    order[one], order[two] = 1, 2
    radius, angle = random.uniform(-0.95, 0.95, samples), random.uniform(0.0, np.pi, samples)
    denominator[one, 1] = -radius[one]
    denominator[two, 1] = -2.0 * (radius * np.cos(angle))[two]
    denominator[two, 2] = radius[two] ** 2
    # The numerator is the denominator reversed.
    at = order[:, None] - np.arange(_ORDER + 1)
    numerator = np.take_along_axis(denominator, np.maximum(at, 0), axis=1) * (at >= 0)
    return numerator * random.choice((-1.0, 1.0), samples)[:, None], denominator


def spectral_radii(
    loop: UncertainLoop, deltas: FloatArray, numerator: FloatArray, denominator: FloatArray
) -> FloatArray:
    """Spectral radius per cycle of M closed by each perturbation."""
    system, reals = loop.system, deltas.shape[1]
    width = reals + 1
    B, C = np.asarray(system.B)[:, :width], np.asarray(system.C)[:width]
    D, A = np.asarray(system.D)[:width, :width], np.asarray(system.A)
    samples = len(deltas)
    # The remainder in controllable canonical form: its input is the last z, its output the
    # last w.
    own_A = np.zeros((samples, _ORDER, _ORDER))
    own_A[:, 0] = -denominator[:, 1:]
    own_A[:, 1:, :-1] = np.eye(_ORDER - 1)
    own_B = np.zeros((samples, _ORDER, width))
    own_B[:, 0, -1] = 1.0
    own_C = np.zeros((samples, width, _ORDER))
    own_C[:, -1] = numerator[:, 1:] - numerator[:, :1] * denominator[:, 1:]
    through = np.zeros((samples, width, width))
    k = np.arange(width)
    through[:, k, k] = np.column_stack((deltas, numerator[:, 0]))
    # w = R (through C x + own_C x_d), z = C x + D w
    R = np.linalg.inv(np.eye(width) - through @ D)
    w_x, w_d = R @ through @ C, R @ own_C
    z_x, z_d = C + D @ w_x, D @ w_d
    closed = np.concatenate(
        (
            np.concatenate((A + B @ w_x, B @ w_d), axis=2),
            np.concatenate((own_B @ z_x, own_A + own_B @ z_d), axis=2),
        ),
        axis=1,
    )
    radii = np.abs(np.linalg.eigvals(closed)).max(axis=1)
    return np.asarray(radii**loop.measurement.n_cylinders)


def sensitivity_peaks(
    loop: UncertainLoop, deltas: FloatArray, numerator: FloatArray, denominator: FloatArray
) -> FloatArray:
    """Largest ``|S|`` of each perturbation, from the description itself rather than from M."""
    m = loop.measurement
    z = np.exp(1j * np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES)
    law = np.asarray(loop.law(z), dtype=complex)
    powers = z ** -np.arange(_ORDER + 1)[:, None]
    remainder = (numerator @ powers) / (denominator @ powers)
    weight = np.asarray(m.weight.system()(z), dtype=complex)
    directions = np.stack([direction(z) for direction in m.directions.values()])
    seen = z**-m.latency * (m.centre(z) + deltas @ directions) + weight * remainder
    return np.asarray(np.abs(1.0 / (1.0 + law * seen)).max(axis=1))
