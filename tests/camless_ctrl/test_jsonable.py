import json
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from camless_ctrl.jsonable import jsonable, to_json


@dataclass
class Shape:
    size: np.ndarray
    hidden: object = field(default=None, repr=False)


def test_numbers_that_json_does_not_know():
    text = to_json({"a": math.nan, "b": math.inf, "c": -np.inf, "d": 1 + 2j})
    assert json.loads(text) == {
        "a": None,
        "b": "inf",
        "c": "-inf",
        "d": {"real": 1.0, "imag": 2.0},
    }


def test_arrays_dataclasses_and_paths():
    value = {"x": Shape(np.array([[1.5, np.nan]])), "y": (np.int64(3), True, np.bool_(False))}
    assert jsonable(value) == {"x": {"size": [[1.5, None]]}, "y": [3, True, False]}
    assert isinstance(jsonable(np.bool_(True)), bool)
    assert jsonable(Path("a") / "b") == "a/b"


def test_what_has_no_form_is_refused():
    with pytest.raises(TypeError, match="object has no form in JSON"):
        to_json({"x": object()})
