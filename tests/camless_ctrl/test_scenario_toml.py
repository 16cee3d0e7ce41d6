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
        ("cylinder = 2", "cylinder = 5", 15, ["deactivated", "5", "4 cylinders"]),
        ("cylinder = 1", "cylinder = 5", 47, ["[[faults]] 2 cylinder", "4 cylinders"]),
        ("[0.0, 2e-4, 0.0, 0.0]", "[0.0, 2e-4]", 33, ["duration_offset has 2 values"]),
        ("[valves]", "[valve]", 32, ["valve", "'valves'"]),
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
    with pytest.raises(ParameterError, match=r"a\.toml:4: \[profile\] demand_mg: .*d\.csv"):
        load_scenario(written(text))


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
