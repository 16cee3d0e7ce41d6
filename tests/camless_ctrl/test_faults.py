import json
import math
import pickle

import numpy as np
import pytest

from camless_ctrl.faults import FAULT_KINDS, Fault
from plant.errors import ParameterError

# What a user can ask for, by hand: the unit of its size, and whether it may be one cylinder's.
KINDS = {
    "maf-stuck": ("kg/s", False),
    "maf-dropout": ("", False),
    "maf-nan": ("", False),
    "maf-offset": ("kg/s", False),
    "maf-drift": ("kg/s per s", False),
    "maf-noise": ("1", False),
    "maf-slow": ("s", False),
    "map-offset": ("Pa", False),
    "map-stuck": ("Pa", False),
    "map-nan": ("", False),
    "duration-missing": ("", True),
    "duration-bias": ("s", True),
    "valve-stuck": ("", True),
    "valve-lift": ("1", True),
    "valve-late": ("s", True),
    "valve-jitter": ("s", True),
    "speed-spike": ("rpm", False),
    "missed-computation": ("", False),
}


def test_every_kind_is_there():
    found = {name: (kind.unit, kind.by_cylinder) for name, kind in FAULT_KINDS.items()}
    assert found == KINDS


def test_kinds_agree_with_themselves():
    for name, kind in FAULT_KINDS.items():
        assert kind.name == name
        assert kind.target in name or name == "missed-computation"
        assert kind.sized == bool(kind.unit)
        if not math.isnan(kind.default):
            assert kind.low <= kind.default <= kind.high
        assert Fault(name, 1.0).size == pytest.approx(kind.default, nan_ok=True)


def test_a_fault_acts_from_its_start_until_its_end():
    fault = Fault("maf-nan", 2.0, 3.0)
    assert [fault.active(t) for t in (1.99, 2.0, 2.99, 3.0)] == [False, True, True, False]
    assert Fault("maf-nan", 2.0).active(1e6)


def test_rounding_of_event_times_decides_nothing():
    # 0.7 + 0.1 is below 0.8, at which the fault ends
    fault = Fault("missed-computation", 0.3, 0.8)
    assert 0.1 + 0.2 > 0.3
    assert fault.active(0.1 + 0.2)
    assert fault.active(0.3 - 1e-16)
    assert not fault.active(0.7 + 0.1)


def test_a_fault_of_one_cylinder_hits_that_one():
    one, each = Fault("valve-stuck", 0.0, cylinder=2), Fault("valve-stuck", 0.0)
    assert [one.hits(i, 1.0) for i in (1, 2, 3)] == [False, True, False]
    assert all(each.hits(i, 1.0) for i in (1, 2, 3))
    assert not Fault("valve-stuck", 2.0, cylinder=2).hits(2, 1.0)


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_survives_json_and_pickle(kind):
    cylinder = 3 if KINDS[kind][1] else None
    for fault in (Fault(kind, 0.1), Fault(kind, 1, 2.5, cylinder=cylinder)):
        assert Fault.from_dict(json.loads(json.dumps(fault.to_dict()))) == fault
        again = pickle.loads(pickle.dumps(fault))
        assert again == fault
        assert hash(again) == hash(fault)
    assert Fault(kind, 0.1) != Fault(kind, 0.2)


def test_what_is_not_given_is_left_out():
    assert Fault("maf-stuck", 1.0).to_dict() == {"kind": "maf-stuck", "start": 1.0}
    assert Fault("maf-stuck", 1.0, size=0.02).to_dict()["size"] == 0.02


def test_numbers_are_plain():
    fault = Fault("valve-late", np.float64(1), np.float64(2), np.float64(1e-3), np.int64(2))
    assert repr(fault) == ("Fault(kind='valve-late', start=1.0, end=2.0, size=0.001, cylinder=2)")


def test_text_tells_size_cylinder_and_times():
    text = str(Fault("valve-lift", 1.0, 2.5, cylinder=2))
    assert text == "valve-lift 0.4 of cylinder 2 from 1 to 2.5 s"
    assert str(Fault("maf-nan", 1.0)) == "maf-nan from 1 s"
    assert str(Fault("map-offset", 0.0)) == "map-offset 5000 Pa from 0 s"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"kind": "maf-stuk", "start": 0.0}, "did you mean 'maf-stuck'"),
        ({"kind": "maf-nan", "start": -1.0}, "start is -1 s"),
        ({"kind": "maf-nan", "start": math.nan}, "start is nan s"),
        ({"kind": "maf-nan", "start": 2.0, "end": 2.0}, "end is 2 s"),
        ({"kind": "maf-nan", "start": 2.0, "end": -math.inf}, "end is -inf s"),
        ({"kind": "maf-nan", "start": 0.0, "size": 1.0}, "has none"),
        ({"kind": "maf-noise", "start": 0.0, "size": 0.5}, "size is 0.5"),
        ({"kind": "valve-lift", "start": 0.0, "size": 1.2}, "size is 1.2"),
        ({"kind": "maf-offset", "start": 0.0, "size": "1"}, "size is '1'"),
        ({"kind": "maf-offset", "start": 0.0, "cylinder": 1}, "not one of a cylinder"),
        ({"kind": "valve-stuck", "start": 0.0, "cylinder": 0}, "cylinder is 0"),
        ({"kind": "valve-stuck", "start": 0.0, "cylinder": 1.5}, "cylinder must be a whole"),
    ],
)
def test_impossible_faults_are_refused(values, message):
    with pytest.raises(ParameterError, match=message):
        Fault(**values)


def test_wrong_keys_are_named():
    with pytest.raises(ParameterError, match="did you mean 'start'"):
        Fault.from_dict({"kind": "maf-nan", "strat": 1.0})
    with pytest.raises(ParameterError, match="lacks start"):
        Fault.from_dict({"kind": "maf-nan"})
