import math

import numpy as np
import pytest

from plant import Engine, ParameterError, engine_fields
from plant.sensors import MAF_DELAYS, MAP_OFFSET_TOLERANCE
from uncertainty.parameters import UncertainParameter, UncertaintySet


def parameter(**changes):
    fields = {
        "name": "temperature",
        "low": 0.9,
        "high": 1.1,
        "nominal": 1.0,
        "acts_on": ("temperature",),
    }
    return UncertainParameter(**(fields | changes))


def test_bounds_and_nominal_values_are_arrays_in_order():
    both = UncertaintySet((parameter(), parameter(name="flow", low=0.8, acts_on=("bore",))))
    assert both.low.tolist() == [0.9, 0.8]
    assert both.high.tolist() == [1.1, 1.1]
    assert both.nominal.tolist() == [1.0, 1.0]
    assert (len(both), both.names) == (2, ("temperature", "flow"))
    assert both["flow"].low == 0.8
    assert [p.name for p in both] == list(both.names)


def test_the_documented_default_bounds():
    plant = UncertaintySet.plant()
    # 0.5 to 2 of the damping; 0.2 ms of duration; 270 to 319 K, the printed 316 K included
    assert (plant["runner damping"].low, plant["runner damping"].high) == (0.5, 2.0)
    assert plant["duration offset"].high == -plant["duration offset"].low == 2e-4
    kelvin = 290.0 * np.array([plant["temperature"].low, plant["temperature"].high])
    assert kelvin == pytest.approx([270.0, 319.0], abs=0.5)
    assert kelvin[0] < 316.0 < kelvin[1]
    sensors = UncertaintySet.sensors()
    assert (sensors["MAF delay"].low, sensors["MAF delay"].high) == MAF_DELAYS
    assert sensors["MAP offset"].high == MAP_OFFSET_TOLERANCE
    each = UncertaintySet.cylinders(3)
    assert len(each) == 6
    assert {p.acts_on[0] for p in each} == {
        f"{name}[{i}]" for name in ("cylinder_flow_factors", "duration_offset") for i in range(3)
    }


@pytest.mark.parametrize("n", [1, 4, 6])
def test_the_default_sets_suit_the_paper_engine(n):
    engine = Engine.paper().replace(n_cylinders=n)
    whole = UncertaintySet.plant() + UncertaintySet.cylinders(n) + UncertaintySet.sensors()
    whole.check_engine(engine)
    fields = {t for p in UncertaintySet.plant() for t in p.acts_on} - {"duration_offset"}
    assert fields <= set(engine_fields(engine))
    assert all(p.low <= p.nominal <= p.high and p.source for p in whole)


def test_sets_add_select_and_replace():
    runner, offset = UncertaintySet.runner(), UncertaintySet.delivered_duration()
    both = runner + offset
    assert both.names == runner.names + offset.names
    assert both.only(["duration offset"]) == offset
    wider = both.replace("runner damping", high=3.0)
    assert wider["runner damping"].high == 3.0
    assert both["runner damping"].high == 2.0
    assert wider.names == both.names
    with pytest.raises(ParameterError, match="the set holds duration offset more than once"):
        both + offset
    with pytest.raises(TypeError):
        both + 1


def test_a_set_prints_a_line_for_each_parameter():
    text = str(UncertaintySet.runner() + UncertaintySet.delivered_duration())
    assert "runner damping 0.5 to 2 of nominal" in text
    assert "duration offset -0.0002 to 0.0002 s" in text


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"low": 1.2}, "high of temperature is 1.1, but must be in"),
        ({"nominal": 2.0}, "the bounds must enclose the nominal value"),
        ({"low": math.nan}, "low of temperature is nan"),
        ({"high": math.inf}, "high of temperature is inf"),
        ({"low": "cold"}, "must be a number"),
        ({"name": ""}, "lacks a name or a target"),
        ({"acts_on": ()}, "lacks a name or a target"),
        ({"acts_on": "temperature"}, "must be a tuple of targets"),
        ({"acts_on": ("maf.gain_error",)}, "offsets and sensor fields are given as values"),
        ({"acts_on": ("duration_offset",)}, "offsets and sensor fields are given as values"),
    ],
)
def test_impossible_parameters_are_refused(changes, message):
    with pytest.raises(ParameterError, match=message):
        parameter(**changes)


def test_a_value_is_given_once():
    absolute = {"relative": False, "low": 280.0, "high": 300.0, "nominal": 290.0, "unit": "K"}
    with pytest.raises(ParameterError, match="more than one parameter gives a value to temp"):
        UncertaintySet((parameter(name="a", **absolute), parameter(name="b", **absolute)))
    UncertaintySet((parameter(name="a", **absolute), parameter(name="b")))  # a factor on a value
    offsets = UncertaintySet.delivered_duration()["duration offset"]
    UncertaintySet((offsets, offsets.replace(name="another")))  # offsets add


def test_names_and_targets_that_are_unknown_suggest_the_nearest():
    runner = UncertaintySet.runner()
    with pytest.raises(ParameterError, match="did you mean 'runner damping'"):
        runner["runner dampng"]
    with pytest.raises(ParameterError, match="did you mean 'runner area'"):
        runner.replace("runner are", low=0.9)
    with pytest.raises(ParameterError, match=r"no field 'lowest'.*its fields are"):
        runner.replace("runner area", lowest=0.9)
    engine = Engine.paper()
    for target, nearest in (
        ("temprature", "temperature"),
        ("helmholtz.low_speed_dampin", "helmholtz.low_speed_damping"),
        ("cylinder_flow_factors[4]", r"cylinder_flow_factors\[\d\]"),
    ):
        with pytest.raises(ParameterError, match=f"did you mean '{nearest}'"):
            UncertaintySet((parameter(acts_on=(target,)),)).check_engine(engine)
    fifth = UncertaintySet((UncertaintySet.cylinders(5)["duration offset 5"],))
    with pytest.raises(ParameterError, match=r"target of duration offset 5 is 'duration_offset\[4"):
        fifth.check_engine(engine)


def test_bounds_that_the_engine_cannot_take_name_the_parameter():
    engine = Engine.paper()
    strong = engine.replace(helmholtz=engine.helmholtz.replace(high_speed_damping=0.6))
    UncertaintySet.runner().check_engine(engine)
    with pytest.raises(ParameterError) as caught:  # 0.6 x 2 is overdamped
        UncertaintySet.runner().check_engine(strong)
    for words in (
        "runner damping at its bound 2",
        "high_speed_damping is 1.2",
        "narrow its bounds",
    ):
        assert words in str(caught.value)
    with pytest.raises(ParameterError, match=r"oscillation decay at its bound 1.3 is impossible"):
        UncertaintySet.oscillation().replace("oscillation decay", high=1.3).check_engine(engine)


def test_factors_that_are_impossible_only_together_are_found():
    engine = Engine.paper()  # decay ratio 0.81
    decay = "valvetrain.oscillation_decay_ratio"
    one, two = (parameter(name=name, high=1.2, acts_on=(decay,)) for name in ("one", "two"))
    UncertaintySet((one,)).check_engine(engine)
    with pytest.raises(ParameterError, match=r"oscillation_decay_ratio is 1\.16"):
        UncertaintySet((one, two)).check_engine(engine)


@pytest.mark.parametrize("number", [0, 2.5])
def test_a_set_of_cylinders_needs_a_number_of_them(number):
    with pytest.raises(ParameterError, match="n_cylinders"):
        UncertaintySet.cylinders(number)
