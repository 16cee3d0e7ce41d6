import numpy as np
import pytest

from camless_ctrl.least_loss_motion import FeedforwardOptions, optimal_motion
from plant import CrankAnglePlant, Engine, MeanValuePlant, ParameterError
from plant.valve import highest_lift_mm

AMBIENT = 1e5 * 4e-4 / (287.0 * Engine.paper().temperature)  # kg, density times displacement


@pytest.fixture(scope="session")
def motion_maps():
    return MeanValuePlant.fit(CrankAnglePlant(Engine.paper(), runner=True, oscillation=True))


def loss_along_charge(maps, charge, lift, speed):
    """Loss where the map's inverse meets the charge at a lift: no solver involved."""
    duration = maps.duration_for_charge(charge, lift, speed).duration_deg
    return maps.pumping_loss(lift, duration, speed, outside="nan")


def scanned(maps, charge, speed, low=0.5, high=8.0, longest=240.0):
    lifts = np.linspace(low, high, 601)
    duration = maps.duration_for_charge(charge, lifts, speed).duration_deg
    loss = maps.pumping_loss(lifts, duration, speed, outside="nan")
    return np.nanmin(np.where(duration <= longest, loss, np.nan))


@pytest.mark.parametrize(
    ("share", "speed"), [(0.12, 1700.0), (0.15, 2500.0), (0.3, 2500.0), (0.1, 5000.0), (0.12, 6000)]
)
def test_inner_optimum_is_stationary_along_the_charge_by_differences_of_the_map(
    motion_maps, share, speed
):
    motion = optimal_motion(motion_maps, share * AMBIENT, speed)
    assert motion.optimal
    assert motion.certificate.active == ()
    assert 0.5 < motion.lift_mm < 8.0
    h = 0.02
    below, at, above = (
        loss_along_charge(motion_maps, motion.charge, motion.lift_mm + d, speed)
        for d in (-h, 0.0, h)
    )
    curvature = (above - 2.0 * at + below) / h**2
    assert curvature > 0.0
    # The centre of the parabola through the three points is the optimum to a tenth of a step.
    assert abs((below - above) / (2.0 * h) / curvature) < 0.1 * h
    assert at == pytest.approx(motion.loss, rel=1e-9)


@pytest.mark.parametrize(("share", "speed"), [(0.4, 800.0), (0.6, 2000.0), (0.9, 3500.0)])
def test_bound_optimum_has_the_multiplier_of_the_loss_along_the_charge(motion_maps, share, speed):
    motion = optimal_motion(motion_maps, share * AMBIENT, speed)
    assert motion.optimal
    assert motion.certificate.active == ("highest lift",)
    assert motion.lift_mm == pytest.approx(8.0, abs=1e-6)
    h = 1e-3
    lower = loss_along_charge(motion_maps, motion.charge, np.array([8.0 - h, 8.0]), speed)
    slope = (lower[1] - lower[0]) / h  # J/mm, negative: more lift would lose less
    assert slope < 0.0
    multiplier = motion.certificate.multipliers["highest lift"]
    assert multiplier == pytest.approx(-slope * 8.0 / motion.cost, rel=2e-3)


@pytest.mark.parametrize(("share", "speed"), [(0.3, 2500.0), (0.5, 1200.0), (0.12, 6000.0)])
def test_marginal_cost_is_the_growth_of_the_least_loss(motion_maps, share, speed):
    charge, step = share * AMBIENT, 1e-4 * AMBIENT
    low, high = (optimal_motion(motion_maps, charge + d, speed).cost for d in (-step, step))
    marginal = optimal_motion(motion_maps, charge, speed).marginal_cost
    assert marginal == pytest.approx((high - low) / (2.0 * step), rel=1e-3)


def test_no_lift_of_a_fine_scan_loses_less(motion_maps):
    random = np.random.default_rng(3)
    for _ in range(25):
        speed = random.uniform(750.0, 6000.0)
        charge = random.uniform(0.1, 0.7) * AMBIENT
        motion = optimal_motion(motion_maps, charge, speed)
        assert motion.optimal
        assert motion.loss <= scanned(motion_maps, charge, speed) * (1.0 + 1e-6)
        reached = motion_maps.air_charge(motion.lift_mm, motion.duration_deg, speed)
        assert reached == pytest.approx(charge, rel=1e-8)
        # Early closing, with authority, and a profile that can be driven.
        slope = motion_maps.charge_gradient(motion.lift_mm, motion.duration_deg, speed).duration
        assert slope >= 5e-4 * AMBIENT
        time = motion.duration_deg / (6.0 * speed)
        assert motion.lift_mm <= highest_lift_mm(time, Engine.paper().valvetrain) * (1.0 + 1e-6)
        assert motion.command.closing_deg == motion.duration_deg


def test_guess_leads_to_the_minimum_next_to_it(motion_maps):
    charge, speed = 0.132 * AMBIENT, 2500.0
    high, low = (optimal_motion(motion_maps, charge, speed, guess=g) for g in (8.0, 4.4))
    assert high.optimal
    assert low.optimal
    assert high.lift_mm - low.lift_mm > 2.0
    best = optimal_motion(motion_maps, charge, speed)
    assert best.cost == pytest.approx(min(high.cost, low.cost), rel=1e-9)


def test_lift_limits_bind_and_are_named(motion_maps):
    low, high = 1.0, 4.0
    options = FeedforwardOptions(lowest_lift_mm=low, highest_lift_mm=high)
    motion = optimal_motion(motion_maps, 0.4 * AMBIENT, 1500.0, options)
    assert motion.certificate.active == ("highest lift",)
    assert motion.lift_mm == pytest.approx(high, abs=1e-6)
    charge, speed = 0.1 * AMBIENT, 6000.0
    free = optimal_motion(motion_maps, charge, speed).lift_mm
    held = optimal_motion(motion_maps, charge, speed, FeedforwardOptions(lowest_lift_mm=free + 0.5))
    assert held.optimal
    assert held.certificate.active == ("lowest lift",)


def test_lift_energy_lowers_the_lift_as_much_as_its_weight_asks(motion_maps):
    charge, speed, weight = 0.4 * AMBIENT, 1500.0, 0.02
    free = optimal_motion(motion_maps, charge, speed)
    motion = optimal_motion(
        motion_maps, charge, speed, FeedforwardOptions(lift_energy_weight=weight)
    )
    assert motion.optimal
    assert motion.lift_mm < free.lift_mm
    assert motion.loss > free.loss
    assert motion.cost == pytest.approx(motion.loss + weight * motion.lift_mm**2, rel=1e-12)
    h = 0.01
    ends = loss_along_charge(
        motion_maps, charge, np.array([motion.lift_mm - h, motion.lift_mm + h]), speed
    )
    # At the optimum the loss falls with lift as fast as the energy rises.
    assert (ends[0] - ends[1]) / (2.0 * h) == pytest.approx(2.0 * weight * motion.lift_mm, rel=5e-3)


def test_lift_move_draws_the_lift_to_the_reference(motion_maps):
    charge, speed = 0.3 * AMBIENT, 1500.0
    distance = []
    for weight in (0.01, 0.1, 1.0, 100.0):
        options = FeedforwardOptions(lift_move_weight=weight, reference_lift_mm=3.0)
        motion = optimal_motion(motion_maps, charge, speed, options)
        assert motion.optimal
        distance.append(abs(motion.lift_mm - 3.0))
    assert distance == sorted(distance, reverse=True)
    assert distance[-1] < 0.01


def test_seating_limit_bounds_the_closing_and_lengthens_nothing(motion_maps):
    charge, speed = 0.5 * AMBIENT, 3000.0
    options = FeedforwardOptions(lift_energy_weight=0.2)
    free = optimal_motion(motion_maps, charge, speed, options)
    latest = free.duration_deg - 4.0
    motion = optimal_motion(motion_maps, charge, speed, options.replace(latest_seating_deg=latest))
    assert motion.optimal
    assert motion.certificate.active == ("longest duration",)
    assert motion.command.closing_deg == pytest.approx(latest, rel=1e-7)
    assert motion.lift_mm > free.lift_mm  # less time takes more lift


def test_least_dwell_is_kept_and_named(motion_maps):
    valvetrain = Engine.paper().valvetrain
    charge, speed = 0.1 * AMBIENT, 3100.0
    options = FeedforwardOptions(least_dwell=4e-4)
    motion = optimal_motion(motion_maps, charge, speed, options)
    assert motion.optimal
    assert "dwell" in motion.certificate.active
    ramps = 2.0 * 0.7 * motion.lift_mm / valvetrain.opening_slope_mm_s
    seating = valvetrain.seating_duration * (1.0 - 200.0 / 3500.0)
    dwell = motion.duration_deg / (6.0 * speed) - ramps - seating  # Eq. 20
    assert dwell == pytest.approx(4e-4, rel=1e-5)


def test_authority_is_kept(motion_maps):
    def authority(motion):
        slope = motion_maps.charge_gradient(motion.lift_mm, motion.duration_deg, speed).duration
        return float(slope) / AMBIENT

    charge, speed = 0.12 * AMBIENT, 5500.0
    free = authority(optimal_motion(motion_maps, charge, speed))
    options = FeedforwardOptions(least_authority=1.02 * free)
    motion = optimal_motion(motion_maps, charge, speed, options)
    assert motion.optimal
    assert "authority" in motion.certificate.active
    assert authority(motion) == pytest.approx(1.02 * free, rel=1e-5)
    with pytest.raises(ParameterError, match="mg"):
        optimal_motion(motion_maps, 0.99 * AMBIENT, 750.0, FeedforwardOptions(least_authority=3e-3))


@pytest.mark.parametrize(("cylinders", "longest"), [(3, 240.0), (4, 240.0), (6, 230.0), (8, 170.0)])
def test_longest_duration_leaves_no_third_event_open(motion_maps, cylinders, longest):
    engine = Engine.paper().replace(n_cylinders=cylinders)
    assert FeedforwardOptions().longest_deg(engine, motion_maps.region) == longest


def test_a_charge_out_of_reach_is_told_with_what_can_be_had(motion_maps):
    with pytest.raises(ParameterError, match=r"change the charge, the speed or the options"):
        optimal_motion(motion_maps, 600e-6, 1500.0)
    with pytest.raises(ParameterError, match="speed_rpm is 7000"):
        optimal_motion(motion_maps, 200e-6, 7000.0)
    with pytest.raises(ParameterError, match="charge is nan"):
        optimal_motion(motion_maps, float("nan"), 1500.0)
    with pytest.raises(ParameterError, match="guess is 9"):
        optimal_motion(motion_maps, 200e-6, 1500.0, guess=9.0)
    with pytest.raises(ParameterError, match="range of the maps"):
        optimal_motion(motion_maps, 200e-6, 1500.0, FeedforwardOptions(highest_lift_mm=9.0))


@pytest.mark.parametrize(
    "wrong",
    [
        {"lowest_lift_mm": 0.0},
        {"highest_lift_mm": 0.4},
        {"longest_duration_deg": 400.0},
        {"latest_seating_deg": -1.0},
        {"least_dwell": -1e-3},
        {"lowest_charge_share": 0.0},
        {"least_authority": 0.0},
        {"lift_energy_weight": -1.0},
        {"lift_move_weight": float("nan")},
        {"reference_lift_mm": 9.0},
        {"steepest_lift_mm": 0.0},
        {"steepest_over_speed_mm": -1.0},
    ],
)
def test_impossible_options_are_named(wrong):
    (name,) = wrong
    with pytest.raises(ParameterError, match=name):
        FeedforwardOptions(**wrong)


def test_motion_prints_its_proof(motion_maps):
    text = str(optimal_motion(motion_maps, 250e-6, 1500.0))
    assert "250.0 mg at 1500 rpm" in text
    assert "optimal (Solve_Succeeded" in text
    assert "active: highest lift" in text
