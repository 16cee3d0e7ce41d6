import shutil
import tomllib

import pytest

from camless_ctrl import _toml_lines
from camless_ctrl.faults import Fault
from camless_ctrl.metrics import AlarmTime
from camless_ctrl.operating_profile import Signal
from camless_ctrl.scenario_toml import load_scenario, load_scenarios
from camless_ctrl.shipped import FOLDER
from plant import ParameterError
from plant.sampling import CrankSampling

TEXT = '''\
name = "first"
description = """
A text [of] several
lines = 3"""
seed = 4

[profile] # what is asked
length = 6.0
demand_mg = { steps = [
    170.0, # mg
    400.0,
], at = [2.0] }
speed_rpm = 1500.0

[[profile.deactivated]]
cylinder = 2
start = 1.0

[engine]
n_cylinders = 4

[engine.valvetrain]
roundness = 0.3

[true]
cylinder_flow_factors = [1.03, 0.85, 0.96, 1.05]

[sensors.maf]
time_constant = 0.02
sampling = { step_deg = 6.0 }

[valves]
duration_offset = [0.0, 2e-4, 0.0, 0.0]

[controller]
law = "gradient"
warm_up_cycles = 10

[[faults]]
kind = "maf-nan"
start = 2.0

[[faults]]
kind = "valve-lift"
start = 3.0
size = 0.5
cylinder = 1

[[requirements]]
name = "alarm"
kind = "alarm-time"
alarm = "maf"
bound = 40
source = "a test"
'''


@pytest.fixture
def written(tmp_path):
    def write(text, name="a.toml"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / name

    return write


def test_a_file_is_the_scenario_that_it_tells(written):
    found = load_scenario(written(TEXT))
    assert found.name == "first"
    assert found.description == "A text [of] several\nlines = 3"
    assert found.seed == 4
    assert found.profile.demand_mg == Signal.steps([170.0, 400.0], at=[2.0])
    assert found.profile.deactivated == ((2, 1.0, 6.0),)
    assert found.true_engine.cylinder_flow_factors == (1.03, 0.85, 0.96, 1.05)
    assert found.sensors.maf.time_constant == 0.02
    assert found.sensors.maf.sampling == CrankSampling(6.0)
    assert found.valves.duration_offset == (0.0, 2e-4, 0.0, 0.0)
    assert found.controller.law == "gradient"
    assert found.controller.warm_up_cycles == 10
    assert found.faults == (Fault("maf-nan", 2.0), Fault("valve-lift", 3.0, size=0.5, cylinder=1))
    assert found.requirements[0].metric == AlarmTime("maf")
    assert found.requirements[0].bound == 40


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("seed = 4", "seed = -4", 5, ["seed", "-4", "from 0"]),
        ("seed = 4", "sed = 4", 5, ["sed", "did you mean 'seed'"]),
        ("speed_rpm = 1500.0", "sped_rpm = 1500.0", 13, ["[profile] sped_rpm", "'speed_rpm'"]),
        ("speed_rpm = 1500.0", "speed_rpm = nan", 13, ["[profile] speed_rpm", "nan", "finite"]),
        ("speed_rpm = 1500.0", "speed_rpm = 10", 13, ["[profile] speed_rpm", "10 rpm", "[50"]),
        ("speed_rpm = 1500.0", "", 7, ["[profile] speed_rpm", "missing"]),
        ("at = [2.0]", "at = [2.0, 3.0]", 9, ["[profile] demand_mg", "one step fewer"]),
        ("    400.0,", "    inf,", 9, ["demand_mg", "inf"]),
        ("cylinder = 2", "cylinder = 0", 16, ["[[profile.deactivated]] 1 cylinder", "from 1"]),
        ("n_cylinders = 4", "n_cylinders = 4.0", 20, ["[engine] n_cylinders", "whole"]),
        ("roundness = 0.3", "roundness = 3.0", 23, ["[engine.valvetrain] roundness", "(0, 1)"]),
        ("0.96, 1.05]", "0.96]", 26, ["[true] cylinder_flow_factors", "3 values"]),
        ("time_constant = 0.02", "time_constant = -1", 29, ["[sensors.maf] time_constant", "-1"]),
        ("step_deg = 6.0", "step_deg = 0.0", 30, ["[sensors.maf.sampling] step_deg"]),
        ("2e-4, 0.0, 0.0]", "2.0, 0.0, 0.0]", 33, ["[valves] duration_offset", "2 s", "0.02"]),
        ('law = "gradient"', 'law = "gradent"', 36, ["[controller] law", "'gradient'"]),
        ('kind = "maf-nan"', 'kind = "maf-na"', 40, ["[[faults]] 1 kind", "'maf-nan'"]),
        ("size = 0.5", "size = 5.0", 46, ["[[faults]] 2 size", "5", "[0, 1]"]),
        ("size = 0.5", "siz = 0.5", 46, ["[[faults]] 2 siz", "'size'"]),
        ("bound = 40", 'bound = "few"', 53, ["[[requirements]] 1 bound", "'few'"]),
        ('alarm = "maf"', "", 49, ["[[requirements]] 1", "alarm"]),
        ('alarm = "maf"', 'alarm = "maff"', 52, ["[[requirements]] 1 alarm", "'maf'"]),
        ('alarm = "maf"', 'alarm = "maf"\nafter = 3', 53, ["[[requirements]] 1 after"]),
        ("cylinder = 2", "cylinder = 5", 16, ["deactivated", "5", "4 cylinders"]),
        ("cylinder = 1", "cylinder = 5", 47, ["[[faults]] 2 cylinder", "4 cylinders"]),
        ("[0.0, 2e-4, 0.0, 0.0]", "[0.0, 2e-4]", 33, ["duration_offset has 2 values"]),
        ("[valves]", "[valve]", 32, ["valve", "'valves'"]),
        ('name = "first"', "", 1, ["name is missing", "a text"]),
        ('name = "first"', "name = 3", 1, ["name is 3", "a text"]),
        (
            "speed_rpm = 1500.0",
            "speed_rpm = [1500.0]",
            13,
            ["[1500.0]", "points, ramp, steps, file"],
        ),
        ("speed_rpm = 1500.0", "speed_rpm = 700.0", 13, ["speed_rpm is 700", "750 to 6000 rpm"]),
        ("speed_rpm = 1500.0", "speed_rpm = 6001.0", 13, ["speed_rpm is 6001", "750 to 6000 rpm"]),
        ("warm_up_cycles = 10", "speed_range_rpm = [1600, 1700]", 13, ["1500", "1600 to 1700 rpm"]),
        ("warm_up_cycles = 10", "speed_range_rpm = [700, 1700]", 37, ["speed_range_rpm", "750"]),
        ("step_deg = 6.0", "step_deg = 6.0, period = 1e-3", 30, ["step_deg", "only one of them"]),
        ("time_constant = 0.02", "bits = 0", 28, ["[sensors.maf] noise", "bits", "knows_sensors"]),
        ("step_deg = 6.0 }", "step_deg = 6.0 }\nnoise = 0.0\nbits = 0", 31, ["noise is 0"]),
        ("2e-4, 0.0, 0.0]", "2e-4, 0.0, 0.0]\nduration_jitter = 1", 34, ["duration_jitter is 1 s"]),
        (
            "start = 2.0",
            "start = 6.5",
            41,
            ["[[faults]] 1 start", "6.5 s", "last event is at 5.98 s"],
        ),
        ("start = 3.0", "start = 5.99", 45, ["[[faults]] 2 start", "5.99 s", "5.98 s"]),
        ('alarm = "maf"', 'alarm = "maf"\nfault = 3', 53, ["1 fault", "fault is 3", "has 2"]),
        ("bound = 40", "bound = nan", 53, ["bound is nan", "finite number"]),
        ("size = 0.5", "end = inf", 46, ["end is inf", "leave it out"]),
        (
            'kind = "alarm-time"\nalarm = "maf"',
            'kind = "worst-error"\nwithout_cylinders = [1, 5]',
            52,
            ["without_cylinders is 5", "4 cylinders"],
        ),
        (
            'kind = "alarm-time"\nalarm = "maf"',
            'kind = "worst-error"\nwindow = "after"\nfault = 4',
            53,
            ["fault is 4", "from 1 to 2"],
        ),
        ("seed = 4", "seed = = 4", 5, ["no TOML"]),
        ("seed = 4", "seed = 4\nseed = 5", 6, ["no TOML"]),
    ],
)
def test_errors_name_file_line_table_and_key(written, old, new, line, words):
    assert TEXT.count(old) == 1
    with pytest.raises(ParameterError) as error:
        load_scenario(written(TEXT.replace(old, new)))
    text = str(error.value)
    assert f"a.toml:{line}: " in text
    for word in words:
        assert word in text


def test_a_requirement_on_the_first_fault_needs_one(written):
    start, end = TEXT.index("[[faults]]"), TEXT.index("[[requirements]]")
    with pytest.raises(
        ParameterError, match=r"\.toml:39: \[\[requirements\]\] 1 fault: .*has none"
    ):
        load_scenario(written(TEXT[:start] + TEXT[end:]))


def test_only_what_the_run_meets_must_be_in_reach(written):
    # The ramp passes 6000 rpm after the end, the fault starts with the last event, at 5.98 s.
    beyond = "speed_rpm = { ramp = [1500.0, 9000.0], start = 6.0, end = 7.0 }"
    text = TEXT.replace("speed_rpm = 1500.0", beyond).replace("start = 3.0", "start = 5.98")
    assert load_scenario(written(text)).profile.length == 6.0
    later = text.replace("length = 6.0", "length = 7.0")
    with pytest.raises(ParameterError, match=r"a\.toml:13: \[profile\] speed_rpm: .* at 6\.\d+ s"):
        load_scenario(written(later))


@pytest.mark.parametrize("switch", ["knows_sensors = false", None])
def test_sensors_without_noise_are_refused_where_the_estimator_is_made_for_them(written, switch):
    text = TEXT.replace("time_constant = 0.02", "bits = 0")
    if switch is None:
        with pytest.raises(
            ParameterError, match=r"a\.toml:28: \[sensors\.maf\] noise: .*no solution"
        ):
            load_scenario(written(text))
    else:
        text = text.replace("warm_up_cycles = 10", switch)
        assert load_scenario(written(text)).sensors.maf.bits is None


SEVERAL = """\
[[scenario]]
name = "one"
profile = { demand_mg = 200.0, speed_rpm = 1500.0, length = 1.0 }

[[scenario]]
name = "two"

[scenario.profile]
demand_mg = 200.0
speed_rpm = 1500.0
length = 2.0

[[scenario.faults]]
kind = "maf-nan"
start = 0.5

[[scenario.faults]]
kind = "map-nan"
start = 0.5
"""


def test_a_file_may_hold_several(written):
    one, two = load_scenarios(written(SEVERAL))
    assert (one.name, one.profile.length, one.faults) == ("one", 1.0, ())
    assert (two.name, two.profile.length) == ("two", 2.0)
    assert [fault.kind for fault in two.faults] == ["maf-nan", "map-nan"]


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ('"map-nan"', '"map-non"', 18, ["[[scenario.faults]] 2 kind"]),
        ("length = 1.0", "length = -1.0", 3, ["[scenario.profile] length", "-1"]),
        ("length = 2.0", "length = -2.0", 11, ["[scenario.profile] length", "-2"]),
        ('"two"', '""', 6, ["name"]),
        ('"map-nan"\nstart = 0.5', '"map-nan"\nstart = 2.5', 19, ["[[scenario.faults]] 2 start"]),
        ("speed_rpm = 1500.0\n", "speed_rpm = 500.0\n", 10, ["[scenario.profile] speed_rpm"]),
    ],
)
def test_errors_in_one_of_several_name_its_lines(written, old, new, line, words):
    with pytest.raises(ParameterError) as error:
        load_scenarios(written(SEVERAL.replace(old, new)))
    assert f"a.toml:{line}: " in str(error.value)
    for word in words:
        assert word in str(error.value)


def test_one_scenario_is_not_chosen_out_of_several(written):
    with pytest.raises(ParameterError, match=r"holds 2 scenarios \(one, two\)"):
        load_scenario(written(SEVERAL))


def test_keys_beside_several_scenarios_are_refused(written):
    with pytest.raises(ParameterError, match=r"a\.toml:1: seed: .*\[\[scenario\]\]"):
        load_scenarios(written("seed = 3\n" + SEVERAL))


def test_the_same_name_twice_is_refused(written):
    written(SEVERAL)
    path = written(SEVERAL.replace('"one"', '"three"'), "b.toml")
    with pytest.raises(ParameterError, match=r"b\.toml and .*a\.toml both hold .*'two'"):
        load_scenarios(path.parent)


def test_a_folder_is_read_in_the_order_of_its_files(written):
    written(TEXT, "z.toml")
    path = written(SEVERAL)
    assert [s.name for s in load_scenarios(path.parent)] == ["one", "two", "first"]


@pytest.mark.parametrize("name", ["nothing.toml", "."])
def test_what_is_not_there_is_told(tmp_path, name):
    with pytest.raises(ParameterError, match=r"put files|cannot be read"):
        load_scenarios(tmp_path / name)


def test_text_that_is_not_utf8_is_told(tmp_path):
    (tmp_path / "a.toml").write_bytes(b'name = "\xff"')
    with pytest.raises(ParameterError, match=r"a\.toml cannot be read"):
        load_scenario(tmp_path / "a.toml")


def test_tables_lie_beside_the_file(written, tmp_path):
    file = '{ file = "deep/d.csv", column = "mg" }'
    text = f'name = "a"\n[profile]\nspeed_rpm = 1500.0\ndemand_mg = {file}\n'
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "d.csv").write_text("time,mg\n0,100\n2,200\n")
    found = load_scenario(written(text))
    assert found.profile.length == 2.0
    shutil.rmtree(tmp_path / "deep")
    with pytest.raises(
        ParameterError, match=r"a\.toml:4: \[profile\] demand_mg: .*d\.csv"
    ) as error:
        load_scenario(written(text))
    assert str(error.value).count("d.csv") == 1


@pytest.mark.parametrize(
    ("axis", "units", "words"),
    [
        ("time", "s,kW", ["a.toml:4: [profile] demand_mg", "d.csv, row 2, column 'load'", "'kW'"]),
        ("cycles", "s,mg", ["column 'time'", "'s'", "cycles"]),
    ],
)
def test_units_of_a_table_must_fit_the_key_and_the_axis(written, tmp_path, axis, units, words):
    text = (
        f'name = "a"\n[profile]\naxis = "{axis}"\n'
        'demand_mg = { file = "d.csv", column = "load" }\nspeed_rpm = 1500.0\n'
    )
    (tmp_path / "d.csv").write_text(f"time,load\n{units}\n0,100\n2,200\n")
    with pytest.raises(ParameterError) as error:
        load_scenario(written(text))
    for word in words:
        assert word in str(error.value)
    good = {"time": "s,g", "cycles": "cycles,g"}[axis]
    (tmp_path / "d.csv").write_text(f"time,load\n{good}\n0,0.1\n2,0.2\n")
    assert load_scenario(written(text)).profile.demand_mg.values == pytest.approx((100.0, 200.0))


def _keys(data, place=()):
    """Places of all keys, items of lists of tables included, values in lines not."""
    for key, value in data.items():
        yield (*place, key)
        if isinstance(value, dict):
            yield from _keys(value, (*place, key))
        elif isinstance(value, list) and value and all(isinstance(v, dict) for v in value):
            for i, item in enumerate(value):
                yield from _keys(item, (*place, key, i))


@pytest.mark.parametrize("text", [TEXT, SEVERAL, *(p.read_text() for p in FOLDER.glob("f*.toml"))])
def test_each_key_is_found_on_a_line_that_names_it(text):
    lines = text.splitlines()
    places = list(_keys(tomllib.loads(text)))
    assert len(places) > 5
    for place in places:
        line = lines[_toml_lines.key_line(text, place) - 1]
        # A key within the braces of a value stands on the line of the key with the braces.
        names = [step for step in place if isinstance(step, str)]
        assert any(name in line for name in names[-2:]), (place, line)
