from dataclasses import dataclass

import numpy as np
import pytest

from camless_ctrl._sampled_estimates import estimate_response, trimmed_sample
from camless_ctrl.feedforward import Feedforward
from camless_ctrl.linearise import local_response
from camless_ctrl.measurement_response import FlowShape, MeasurementResponse
from camless_ctrl.uncertain_measurement import (
    MODELLED,
    UncertainMeasurement,
    uncertain_measurement,
)
from plant import CrankAnglePlant, MafSensor, MeanValuePlant, ParameterError
from uncertainty import default_set
from uncertainty.coverage import samples_needed
from uncertainty.perturbed import PerturbedPlants
from uncertainty.pulse_sampling import sampled_pulses
from uncertainty.sampling import Sample, draw, nominal_sample, one_at_a_time

SPEED, DEMAND = 1500.0, 250e-6
QUICK = {"share": 0.8, "confidence": 0.8, "design": 8, "fresh": 20}
ANGLE = np.linspace(0.0, np.pi, 181)
Z = np.exp(1j * ANGLE)


@dataclass
class Case:
    plant: CrankAnglePlant
    feedforward: Feedforward
    found: UncertainMeasurement
    reported: list[tuple[int, int]]


@pytest.fixture(scope="module")
def case():
    plant = CrankAnglePlant(runner=True, oscillation=True)
    maps = MeanValuePlant.fit(CrankAnglePlant(), tolerance=0.05, most_points=512)
    feedforward, reported = Feedforward(maps), []
    found = uncertain_measurement(
        plant, feedforward, DEMAND, SPEED, progress=lambda *x: reported.append(x), **QUICK
    )
    return Case(plant, feedforward, found, reported)


def by_differences(case: Case, sample: Sample, i: int) -> np.ndarray:
    """Response of one sampled plant by a second way: steady cycles on either side of a command.

    The plant is trimmed by bisection of its duration; charge and flow that one cylinder adds
    are central differences of whole steady cycles, not a pulse followed in time.
    """
    plants = PerturbedPlants(case.plant, sample)
    plant, local = plants.plant_at(i), case.found.local
    command = plants.commands_at(i, local.command, SPEED)[0]
    n, parts = plant.engine.n_cylinders, 60

    def cycle(first, others):
        commands = [command.replace(duration_deg=d) for d in (first, *[others] * (n - 1))]
        return plant.steady_cycle(SPEED, commands, on_infeasible="limit")

    low, high = command.duration_deg - 25.0, command.duration_deg + 25.0
    for _ in range(22):
        middle = 0.5 * (low + high)
        charge = cycle(middle, middle).air_charge[0]
        low, high = (middle, high) if charge < DEMAND else (low, middle)
    # Relative charge that the controller believes in, per deg.
    believed = local.charge / local.factor
    slope = case.feedforward.sensitivity(believed, SPEED) / believed
    step = 0.01 / slope
    sides = [cycle(middle + change, middle) for change in (-0.5 * step, 0.5 * step)]
    flows = [
        c.trace_at(plant.engine.event_angle_deg / (4 * parts))
        .throttle_flow.reshape(n * parts, 4)
        .sum(axis=1)
        for c in sides
    ]
    added = flows[1] - flows[0]
    gain = float((sides[1].air_charge - sides[0].air_charge).sum()) / DEMAND / 0.01
    sensor = plants.maf_at(i, MafSensor())
    response = MeasurementResponse.of_maf(
        case.found.estimator,
        case.found.event_time,
        time_constant=sensor.time_constant,
        delay=sensor.delay,
        shape=FlowShape(added / added.sum(), parts),
    )
    return gain * (1.0 + sensor.gain_error) * response(Z)


def outside(case: Case, sample: Sample, i: int) -> float:
    """Residual of a plant beyond the weight, at its worst frequency."""
    found, values = case.found, sample.at(i)
    expected = found.centre(Z)
    for name in MODELLED:
        p = found.uncertain[name]
        d = (values[name] - 0.5 * (p.low + p.high)) / (0.5 * (p.high - p.low))
        expected = expected + d * found.directions[name](Z)
    left = np.abs(by_differences(case, sample, i) - expected)
    return float((left - found.weight.magnitude(ANGLE / found.event_time)).max())


def test_nominal_is_the_response_of_steady_cycles(case):
    local = local_response(case.plant, case.feedforward, DEMAND, SPEED)
    second = MeasurementResponse.of_maf(
        case.found.estimator,
        case.found.event_time,
        time_constant=15e-3,
        delay=1e-3,
        shape=local.shape,
    )
    # Observed: 4e-5. The pulse is one-sided, the difference central.
    np.testing.assert_allclose(case.found.nominal(Z), local.sensitivity * second(Z), atol=1e-3)


def test_flow_is_linear_between_its_samples(case):
    # As the quantifier takes it, whose shape is checked by itself.
    local, estimator = case.found.local, case.found.estimator
    plants = PerturbedPlants(case.plant, nominal_sample(case.found.uncertain))
    pulses = sampled_pulses(plants, local.command, SPEED, reference_charge=DEMAND)
    found = estimate_response(pulses, 0, estimator, DEMAND, 1.0)
    expected = MeasurementResponse.of_maf(
        estimator, found.event_time, time_constant=15e-3, delay=1e-3, shape=pulses.flow_shape(60)
    )
    np.testing.assert_allclose(found(Z) / found(1.0), expected(Z) / expected(1.0), atol=1e-12)


def test_design_plants_lie_within_the_description(case):
    # Every parameter at each bound, and the nominal plant: all are in the design sample.
    sample = one_at_a_time(case.found.uncertain).joined(nominal_sample(case.found.uncertain))
    worst = max(outside(case, sample, i) for i in range(len(sample)))
    assert worst < 2e-3  # what the differences of two ways may be, of an estimate of 1


def test_calibration_plants_lie_within_the_description(case):
    # None is left out of as many as are needed at the least; drawn again here.
    count = samples_needed(QUICK["share"], QUICK["confidence"])
    seed = int(np.random.SeedSequence(0).generate_state(3)[1])
    sample = draw(case.found.uncertain, count, seed)
    assert count == 8  # 0.8^8 = 0.17 < 0.2
    assert max(outside(case, sample, i) for i in range(count)) < 2e-3


def test_description_is_not_idle(case):
    # Plants beyond the set lie outside: a lag of 40 ms, at its own place or at none.
    p = case.found.uncertain["MAF time constant"]
    wide = case.found.uncertain.replace(p.name, high=0.04)
    sample = nominal_sample(wide)
    values = sample.values.copy()
    values[0, wide.names.index(p.name)] = 0.04
    far = by_differences(case, Sample(wide, values), 0)
    size = case.found.weight.magnitude(ANGLE / case.found.event_time)
    for value in (0.04, 0.02, 0.01):
        near = case.found.response(Z, case.found.deltas({p.name: value}))
        assert np.any(np.abs(far - near) > size)


def test_trimmed_plants_take_in_the_demand(case):
    found = case.found
    sample = draw(found.uncertain, 6, 5)
    believed = found.local.charge / found.local.factor
    slope = case.feedforward.sensitivity(believed, SPEED) / believed
    trimmed = trimmed_sample(case.plant, sample, found.local, DEMAND, slope)
    plants = PerturbedPlants(case.plant, trimmed)
    untrimmed = PerturbedPlants(case.plant, sample)
    errors = []
    for i in range(len(sample)):
        for of, keep in ((plants, errors), (untrimmed, [])):
            commands = of.commands_at(i, found.local.command, SPEED)
            cycle = of.plant_at(i).steady_cycle(SPEED, commands, on_infeasible="limit")
            keep.append(float(np.abs(cycle.air_charge / DEMAND - 1.0).max()))
            if of is untrimmed:
                assert keep[-1] > 2e-3  # the trim was needed
    assert max(errors) < 2.1e-3


def test_deltas_and_values_are_inverse(case):
    found = case.found
    assert found.deltas({"MAF delay": 3e-3})["MAF delay"] == pytest.approx(1.0)
    assert found.deltas({})["MAF delay"] == pytest.approx(-1.0 / 3.0)  # 1 ms of 0 to 3 ms
    assert found.values({"MAF time constant": -1.0}) == {"MAF time constant": pytest.approx(0.01)}
    values = {name: found.uncertain[name].high for name in MODELLED}
    assert found.values(found.deltas(values)) == pytest.approx(values)


def test_gain_error_has_the_direction_that_it_must(case):
    # A gain error of 3 % changes the estimate by 3 %, whatever the frequency. It takes enough
    # design plants to tell it from what other parameters do.
    found = measure(case, design=64)
    direction = found.directions["MAF gain error"](Z)
    assert np.abs(direction - 0.03 * found.centre(Z)).max() < 0.005


def test_progress_counts_every_plant(case):
    counts, totals = zip(*case.reported, strict=True)
    assert set(totals) == {counts[-1]}
    assert counts == tuple(range(1, counts[-1] + 1))


def test_it_prints_and_plots(case):
    import matplotlib.pyplot as plt

    text = str(case.found)
    assert "1500 rpm, 250 mg: 5 real parameters" in text
    assert "of 20 fresh samples" in text
    ax = case.found.plot()
    assert [line.get_label() for line in ax.get_lines()] == [*MODELLED, "all else (complex)"]
    styles = {(line.get_linestyle(), line.get_color()) for line in ax.get_lines()}
    assert len(styles) == len(MODELLED) + 1
    plt.close(ax.figure)


def measure(case: Case, demand: float = DEMAND, **options):
    return uncertain_measurement(
        case.plant, case.feedforward, demand, SPEED, **{**QUICK, **options}
    )


def test_unknown_and_fixed_parameters_are_refused(case):
    with pytest.raises(ParameterError, match="viscosity"):
        measure(case, modelled=("viscosity",))
    with pytest.raises(ParameterError, match="name one or more"):
        measure(case, modelled=())
    fixed = default_set().replace("MAF delay", low=1e-3, high=1e-3)
    with pytest.raises(ParameterError, match=r"MAF delay.* no range"):
        measure(case, uncertain=fixed)


def test_demand_out_of_reach_is_refused(case):
    with pytest.raises(ParameterError, match="demand is 600 mg, but the nominal plant takes in"):
        measure(case, 600e-6)
    # In reach of the nominal plant, but not of every sample: the charge at the shortest event
    with pytest.raises(ParameterError, match="more than the demand of 2 mg"):
        measure(case, 2e-6)
    with pytest.raises(ParameterError, match="demand"):
        measure(case, -1e-6)


def test_one_parameter_alone_needs_a_larger_remainder(case):
    # Every direction that is left out goes to the weight.
    small = measure(case, modelled=("MAF delay",))
    assert tuple(small.directions) == ("MAF delay",)
    omega = ANGLE / case.found.event_time
    assert small.weight.magnitude(omega).max() > case.found.weight.magnitude(omega).max()
