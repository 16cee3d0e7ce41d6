"""Compiled algebra of the Kalman charge estimator: prior, step and compressed measurement."""

from __future__ import annotations

import math

from plant.kinematics import FloatArray

from ._air_path_kernel import (
    AMBIENT,
    AMBIENT_DRIFT,
    AMBIENT_SPREAD,
    AREA,
    BEFORE,
    CHARGE,
    CHARGE_SPREAD,
    DELAY,
    LAG,
    LONGEST_DELAY,
    MAF_DELAY,
    MAF_LAG,
    MAF_SPAN,
    MAP_LAG,
    MOST_SAMPLES,
    OUTPUT,
    OUTPUT_DRIFT,
    RATIO,
    SLOW,
    STATES,
    inlined,
    quasi_steady,
)  # fmt: skip

# Written by `advance`: prior, covariance, compressed measurement and its matrix
PRIOR = 0
COVARIANCE = PRIOR + STATES
MEASURED = COVARIANCE + STATES * STATES
MATRIX = MEASURED + STATES
RESULTS = MATRIX + STATES * STATES

# A step of the states that makes the linearisation worth repeating: of a charge, the ratio and
# the ambient pressure, as shares of them; and of lag and delay. Since the pressure drop goes
# with the square of the flow, a charge that is 3 % off costs at most half its square, 0.05 %.
_NEAR_CHARGE, _NEAR_RATIO, _NEAR_AMBIENT = 0.03, 0.01, 0.0005
_NEAR_TIME = 2e-4  # s
_BEYOND = 1e-4  # s, by which noise may carry a delay out of its range


@inlined
def move(
    P: FloatArray, information: FloatArray, vector: FloatArray, matrix: FloatArray, step: FloatArray
) -> float:
    """Solve ``(1 + P I) step = P v``; of `information` the lower half is read, the other filled in.

    Returns ``v . step``.
    """
    for i in range(STATES):
        for j in range(i):
            information[j, i] = information[i, j]
    for i in range(STATES):
        total = 0.0
        for j in range(STATES):
            total += P[i, j] * vector[j]
            matrix[i, j] = 1.0 if i == j else 0.0
        for k in range(STATES):
            by = P[i, k]
            for j in range(STATES):
                matrix[i, j] += by * information[k, j]
        step[i] = total
    for k in range(STATES):  # elimination with row pivoting, scaled by the prior's spread
        best, row = -1.0, k
        for i in range(k, STATES):
            size = abs(matrix[i, k]) / math.sqrt(P[i, i])
            if size > best:
                best, row = size, i
        if row != k:
            for j in range(STATES):
                matrix[k, j], matrix[row, j] = matrix[row, j], matrix[k, j]
            step[k], step[row] = step[row], step[k]
        for i in range(k + 1, STATES):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k, STATES):
                matrix[i, j] -= factor * matrix[k, j]
            step[i] -= factor * step[k]
    total = 0.0
    for i in range(STATES - 1, -1, -1):
        for j in range(i + 1, STATES):
            step[i] -= matrix[i, j] * step[j]
        step[i] /= matrix[i, i]
        total += vector[i] * step[i]
    return total


@inlined
def compress(
    information: FloatArray, vector: FloatArray, prior: FloatArray, out: FloatArray
) -> None:
    """Write a measurement of unit noise, and its matrix, with these normal equations.

    They are about the prior; the measurement is that of the states themselves.
    """
    for i in range(STATES):
        out[MEASURED + i] = 0.0
        for j in range(STATES):
            out[MATRIX + STATES * i + j] = 0.0
    for k in range(STATES):  # row k of the matrix is column k of the Cholesky factor
        pivot = information[k, k]
        for m in range(k):
            pivot -= out[MATRIX + STATES * m + k] ** 2
        if not pivot > 1e-12 * information[k, k]:
            continue  # what the samples say of this state, they say of those before
        root = math.sqrt(pivot)
        total = vector[k]
        for m in range(k):
            total -= out[MATRIX + STATES * m + k] * out[MEASURED + m]
        out[MEASURED + k] = total / root
        for i in range(k, STATES):
            entry = information[i, k]
            for m in range(k):
                entry -= out[MATRIX + STATES * m + i] * out[MATRIX + STATES * m + k]
            out[MATRIX + STATES * k + i] = entry / root
    for k in range(STATES):
        for i in range(k, STATES):
            out[MEASURED + k] += out[MATRIX + STATES * k + i] * prior[i]


@inlined
def predict(
    numbers: FloatArray,
    x: FloatArray,
    P: FloatArray,
    carry: FloatArray,
    predicted: float,
    length: float,
    prior: FloatArray,
    prior_P: FloatArray,
    moved: FloatArray,
) -> None:
    """Shift the states by one window: see `kalman_estimator`."""
    gradient = carry[1 : 1 + STATES]
    output = carry[0]
    for i in range(STATES):
        output += gradient[i] * (x[i] - carry[1 + STATES + i])
    prior[CHARGE] = predicted
    prior[BEFORE] = x[CHARGE]
    prior[OUTPUT] = output
    prior[AMBIENT] = x[AMBIENT]
    prior[RATIO] = x[RATIO]
    prior[LAG] = x[LAG]
    prior[DELAY] = x[DELAY]
    prior[SLOW] = x[SLOW]
    # What the shifted states are of the old ones, from the left and from the right
    for j in range(STATES):
        moved[BEFORE, j] = P[CHARGE, j]
        total = 0.0
        for i in range(STATES):
            total += gradient[i] * P[i, j]
        moved[OUTPUT, j] = total
        for i in range(AMBIENT, STATES):
            moved[i, j] = P[i, j]
    for i in range(1, STATES):
        prior_P[i, BEFORE] = moved[i, CHARGE]
        total = 0.0
        for j in range(STATES):
            total += moved[i, j] * gradient[j]
        prior_P[i, OUTPUT] = total
        for j in range(AMBIENT, STATES):
            prior_P[i, j] = moved[i, j]
    for i in range(1, STATES):
        for j in range(1, i):
            mean = 0.5 * (prior_P[i, j] + prior_P[j, i])
            prior_P[i, j] = mean
            prior_P[j, i] = mean
        prior_P[i, CHARGE] = 0.0
        prior_P[CHARGE, i] = 0.0
    prior_P[CHARGE, CHARGE] = (numbers[CHARGE_SPREAD] * predicted) ** 2
    prior_P[OUTPUT, OUTPUT] += numbers[OUTPUT_DRIFT] * output * output
    # Events look alike: from a start at high speed a delay may be found an event time off. Of two
    # delays that far apart, the one that is less out of range is taken.
    delay, longest = prior[DELAY], numbers[LONGEST_DELAY]
    shift = length if delay < 0.0 else -length
    out = max(-delay, delay - longest)
    if out > _BEYOND and max(-delay - shift, delay + shift - longest) < out:
        prior[DELAY] += shift
        for i in (BEFORE, OUTPUT):
            for j in range(STATES):
                prior_P[i, j] = prior_P[j, i] = 0.0
        prior_P[BEFORE, BEFORE] = (numbers[CHARGE_SPREAD] * prior[BEFORE]) ** 2
        prior_P[OUTPUT, OUTPUT] = numbers[MAF_SPAN] ** 2
    # A random walk does not spread further than what was known at the start.
    for i in range(AMBIENT, STATES):
        if prior_P[i, i] < numbers[AMBIENT_SPREAD + i - AMBIENT] ** 2:
            prior_P[i, i] += numbers[AMBIENT_DRIFT + i - AMBIENT] * length


@inlined
def ambient_of(
    numbers: FloatArray, otherwise: float, flow: float, samples: FloatArray, n_map: int
) -> float:
    """Ambient pressure that MAP samples and an expected flow tell."""
    total = 0.0
    for b in range(n_map):
        total += samples[3 * MOST_SAMPLES + b]
    if n_map == 0 or not 0.0 < total < math.inf:
        return otherwise
    return total / n_map / quasi_steady(flow / numbers[AREA])


@inlined
def begin(
    numbers: FloatArray,
    ambient: float,
    predicted: float,
    before: float,
    flow: float,
    samples: FloatArray,
    n_map: int,
    prior: FloatArray,
    P: FloatArray,
) -> None:
    """Set the states to what is known without any history."""
    P[:] = 0.0
    prior[CHARGE], prior[BEFORE], prior[OUTPUT] = predicted, before, flow
    prior[RATIO] = 1.0
    prior[AMBIENT] = ambient_of(numbers, ambient, flow, samples, n_map)
    P[CHARGE, CHARGE] = (numbers[CHARGE_SPREAD] * predicted) ** 2
    P[BEFORE, BEFORE] = (numbers[CHARGE_SPREAD] * before) ** 2
    P[OUTPUT, OUTPUT] = numbers[MAF_SPAN] ** 2
    for i in range(AMBIENT, STATES):
        P[i, i] = numbers[AMBIENT_SPREAD + i - AMBIENT] ** 2
    prior[LAG], prior[DELAY] = numbers[MAF_LAG], numbers[MAF_DELAY]
    prior[SLOW] = numbers[MAP_LAG]


@inlined
def all_finite(values: FloatArray) -> bool:
    total = 0.0
    for i in range(values.size):
        total += 0.0 * values[i]  # not 0 if the value is not finite
    return total == 0.0


@inlined
def sound(values: FloatArray) -> bool:
    """Whether states can be put into the air path."""
    return (
        all_finite(values)
        and values[CHARGE] > 0.0
        and values[BEFORE] > 0.0
        and values[AMBIENT] > 0.0
        and values[RATIO] > 0.0
        and values[LAG] >= 0.0
        and values[SLOW] >= 0.0
    )


@inlined
def far(step: FloatArray, at: FloatArray) -> bool:
    """Whether a step is large enough to linearise again."""
    return (
        abs(step[CHARGE]) > _NEAR_CHARGE * at[CHARGE]
        or abs(step[BEFORE]) > _NEAR_CHARGE * at[BEFORE]
        or abs(step[AMBIENT]) > _NEAR_AMBIENT * at[AMBIENT]
        or abs(step[RATIO]) > _NEAR_RATIO * at[RATIO]
        or abs(step[LAG]) + abs(step[DELAY]) + abs(step[SLOW]) > _NEAR_TIME
    )
