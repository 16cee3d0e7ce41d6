"""Each installed solver reproduces the reference cycle; those that are not are named."""

import numpy as np
import pytest

from camless_ctrl.bench import BenchPoint, installed_peers, peers, solve_reference
from camless_ctrl.bench._explicit_peers import ExplicitEuler
from camless_ctrl.bench.comparison import match_setting
from camless_ctrl.bench.points import CHARGE_BAR, LOSS_BAR
from plant import ValveCommand

PEERS, _ = installed_peers()
NAMES = [peer.name for peer in PEERS]
FINE = {"rtol": 1e-8, "us": 0.25}
# errors of first-order Euler at a quarter microsecond; the others are converged there
ALLOWED = {"explicit Euler (Numba)": 1e-4}


@pytest.fixture(scope="module")
def overlapping():
    """Two valves open at once, oscillating, behind a throttle."""
    return solve_reference(
        BenchPoint(3000.0, ValveCommand(5.0, 210.0, -10.0), 40.0, oscillation=True)
    )


@pytest.fixture(scope="module")
def apart():
    """A cam without runner; between the events no cylinder breathes."""
    return solve_reference(
        BenchPoint(2000.0, ValveCommand(6.0, 120.0), 60.0, runner=False, profile="conventional")
    )


@pytest.mark.parametrize("peer", PEERS, ids=NAMES)
def test_peer_reproduces_the_reference(peer, overlapping, apart):
    for reference in (overlapping, apart):
        solution = peer.prepare(reference.problem, FINE[peer.unit])()
        charge, loss = reference.errors(solution.air_charge, solution.pumping_loss)
        assert charge <= ALLOWED.get(peer.name, 2e-6)
        assert loss <= ALLOWED.get(peer.name, 1e-5)


def test_reference_is_the_cycle_of_another_method(overlapping):
    radau = next(peer for peer in PEERS if "Radau" in peer.name)
    other = radau.prepare(overlapping.problem, 1e-9)()
    charge, loss = overlapping.errors(other.air_charge, other.pumping_loss)
    assert charge <= 1e-7
    assert loss <= 1e-6


def test_reference_repeats(overlapping):
    following = overlapping.problem.restarted(overlapping.solution)
    solver = PEERS[0].prepare(following, 1e-10)()
    charge, loss = overlapping.errors(solver.air_charge, solver.pumping_loss)
    assert max(charge, loss) <= 1e-6


def test_setting_is_the_loosest_within_the_bars(apart):
    peer = next(peer for peer in PEERS if peer.name.startswith("explicit Euler"))
    found = match_setting(peer, [apart])
    assert found.meets
    place = peer.settings.index(found.setting)
    looser = peer.prepare(apart.problem, peer.settings[place - 1])()
    charge, loss = apart.errors(looser.air_charge, looser.pumping_loss)
    assert charge > CHARGE_BAR or loss > LOSS_BAR


def test_a_peer_that_never_meets_the_bars_shows_its_best(apart):
    coarse = ExplicitEuler(settings=(512.0, 256.0))
    found = match_setting(coarse, [apart])
    assert not found.meets
    assert np.isfinite(found.charge_error)
    assert found.setting in coarse.settings


@pytest.mark.parametrize("module", ["sksundae", "numbalsoda"])
def test_solver_that_is_not_installed_is_named(monkeypatch, module):
    found = peers.find_spec
    monkeypatch.setattr(peers, "find_spec", lambda name: None if name == module else found(name))
    ready, missing = installed_peers()
    (why,) = [why for name, why in missing.items() if module.removeprefix("sk") in name]
    assert why.startswith("not installed: pip install")
    assert not any(module.removeprefix("sk") in peer.name for peer in ready)
    assert any(peer.name.startswith("scipy LSODA") for peer in ready)
