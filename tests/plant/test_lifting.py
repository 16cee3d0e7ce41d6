import numpy as np
import pytest

from plant._lifting import lifted


def random_events(seed, n, states, inputs, outputs):
    random = np.random.default_rng(seed)
    shapes = (states, states), (states, inputs), (outputs, states), (outputs, inputs)
    return [tuple(random.normal(size=shape) for shape in shapes) for _ in range(n)]


@pytest.mark.parametrize(
    ("n", "states", "inputs", "outputs"), [(1, 2, 1, 1), (3, 4, 2, 3), (4, 3, 3, 1), (6, 2, 1, 2)]
)
def test_two_cycles_of_the_lifted_system_are_those_simulated_event_by_event(
    n, states, inputs, outputs
):
    events = random_events(n, n, states, inputs, outputs)
    random = np.random.default_rng(99)
    start, u = random.normal(size=states), random.normal(size=(2, n, inputs))
    A, B, C, D = lifted(events)
    x, state = start, start
    for cycle in range(2):
        told = C @ state + D @ u[cycle].ravel()
        state = A @ state + B @ u[cycle].ravel()
        seen = []
        for (a, b, c, d), v in zip(events, u[cycle], strict=True):
            seen.append(c @ x + d @ v)
            x = a @ x + b @ v
        np.testing.assert_allclose(told, np.concatenate(seen), rtol=1e-11, atol=1e-11)
        np.testing.assert_allclose(state, x, rtol=1e-11, atol=1e-11)


def test_a_later_input_does_not_act_on_an_earlier_output():
    n, inputs, outputs = 4, 2, 3
    D = lifted(random_events(5, n, 3, inputs, outputs))[3]
    for i in range(n):
        later = D[i * outputs : (i + 1) * outputs, (i + 1) * inputs :]
        assert not later.any()


def test_equal_events_split_into_the_modes_of_one_event():
    # Inputs z^k give outputs G(z) z^k, whatever z: once per event or once per cycle is one system.
    (event,) = random_events(8, 1, 3, 1, 1)
    event = (0.3 * event[0], *event[1:])
    A, B, C, D = lifted([event] * 4)
    for angle in (0.0, 0.4, np.pi / 2, 2.5, np.pi):
        z = np.exp(1j * angle)
        a, b, c, d = event
        single = (c @ np.linalg.solve(z * np.eye(3) - a, b) + d)[0, 0]
        mode = z ** np.arange(4)
        whole = C @ np.linalg.solve(z**4 * np.eye(3) - A, B @ mode) + D @ mode
        np.testing.assert_allclose(whole, single * mode, rtol=1e-11)
