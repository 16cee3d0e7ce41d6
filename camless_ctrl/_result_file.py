"""Results of scenarios in files: CSV, netCDF and JSON, the latter two to be read again."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from plant import Engine, Trace
from plant.errors import ParameterError

from .closed_loop_result import ClosedLoopResult
from .faults import Fault
from .jsonable import jsonable
from .output import reserved_file, reserved_path
from .scenario_result import ScenarioResult

if TYPE_CHECKING:
    import xarray as xr

FORMAT = "camless-ctrl scenario result 1"
_REMEDY = "name a file that to_json(...) or to_netcdf(...) of a result wrote"
_SUFFIXES = ("_mm", "_deg", "_rpm")  # of fields; a dataset tells the unit apart
_CRANK = "crank_"
_CLOCK = "crank_clock"  # time of a trace, which a dataset counts from elsewhere
_OTHER = ("name", "n_cylinders", "seed", "final_state", "faults", "trace")  # are no signals
_SIGNALS = tuple(
    field.name for field in dataclasses.fields(ClosedLoopResult) if field.name not in _OTHER
)
_TRACE = tuple(field.name for field in dataclasses.fields(Trace) if field.name != "engine")


def origin(result: ScenarioResult) -> dict[str, Any]:
    """Attributes of a dataset that say where it comes from; all but the seed are JSON text."""
    return {
        "format": FORMAT,
        "scenario": _text(result.scenario.to_dict()),
        # 64 bits, which netCDF has no number for
        "scenario_seed": str(result.seed),
        "provenance": _text(result.provenance),
    }


def signals(run: ClosedLoopResult) -> dict[str, np.ndarray]:
    """Return the arrays of a run by their field."""
    return {name: np.asarray(getattr(run, name)) for name in sorted(_SIGNALS)}


def trace_signals(run: ClosedLoopResult) -> dict[str, np.ndarray]:
    """Return the arrays over the crank angle by their field; none if not recorded."""
    if run.trace is None:
        return {}
    return {name: np.asarray(getattr(run.trace, name)) for name in _TRACE}


def statement(result: ScenarioResult) -> dict[str, Any]:
    """Return all but signals and provenance as data of JSON: what a file tells of a result."""
    run = result.run
    told = {
        **{key: value for key, value in result.to_dict().items() if key != "provenance"},
        "run": {
            "name": run.name,
            "n_cylinders": run.n_cylinders,
            "seed": run.seed,
            "faults": [fault.to_dict() for fault in run.faults],
        },
    }
    return dict(jsonable(told))


# -- writing -----------------------------------------------------------------------------------


def write_csv(result: ScenarioResult, path: Path) -> None:
    """See `ScenarioResult.to_csv`."""
    with reserved_file(path) as output:
        assert output is not None  # a path is given
        data = result.run.to_dataset()
        names = [str(name) for name in data.data_vars]
        header = ",".join(["event", *(f"{n}[{data[n].attrs.get('units', '1')}]" for n in names)])
        columns = [data[name].values for name in names]
        rows = [
            ",".join([str(k), *(_cell(column[k]) for column in columns)])
            for k in range(data.sizes["event"])
        ]
        output.write("\n".join([header, *rows]) + "\n")


def write_json(result: ScenarioResult, path: Path) -> None:
    """See `ScenarioResult.to_json`."""
    with reserved_file(path) as output:
        assert output is not None  # a path is given
        run = result.run
        crank = trace_signals(run)
        parts = {
            "format": _text(FORMAT),
            **{key: _text(value) for key, value in result.to_dict().items()},
            "run": _lines(
                {
                    "name": _text(run.name),
                    "n_cylinders": _text(run.n_cylinders),
                    "seed": _text(run.seed),
                    "faults": _text([fault.to_dict() for fault in run.faults]),
                    "signals": _arrays(signals(run)),
                    "crank": _arrays(crank) if crank else "null",
                }
            ),
        }
        output.write(_lines(parts) + "\n")


def write_netcdf(result: ScenarioResult, path: Path) -> None:
    """See `ScenarioResult.to_netcdf`."""
    with reserved_path(path) as place:
        run = result.run
        data = run.to_dataset()
        missing = {_plain(name) for name in signals(run)} - {str(name) for name in data.variables}
        if missing:  # else the file could not be read again
            raise AssertionError(f"the dataset lacks {', '.join(sorted(missing))}")
        if run.trace is not None:
            crank = run.crank_dataset()
            renamed = {name: f"{_CRANK}{name}" for name in crank.data_vars}
            crank = crank.rename(renamed).rename_dims({"cylinder": "of_cylinder"})
            clock = ("crank_angle", run.trace.time, {"units": "s", "long_name": "as recorded"})
            data = data.merge(crank.drop_vars("cylinder").assign({_CLOCK: clock}))
        data = data.assign_attrs(
            {
                **origin(result),
                "run_name": run.name,
                "run_seed": str(run.seed),
                "run_faults": _text([fault.to_dict() for fault in run.faults]),
                "dtypes": _text({k: str(v.dtype) for k, v in signals(run).items()}),
                "verdicts": _text([verdict.to_dict() for verdict in result.verdicts]),
                "met": _text(result.met),
            }
        )
        for name in ("name", "seed"):
            data.attrs.pop(name, None)
        data.to_netcdf(place, engine="scipy")


# -- reading -----------------------------------------------------------------------------------


class Stored(NamedTuple):
    """A result that was read.

    Attributes
    ----------
    result : ScenarioResult
        The result; its verdicts are found anew.
    told : dict
        What the file tells, in the form of `statement`: the verdicts of then.
    """

    result: ScenarioResult
    told: dict[str, Any]


def read(path: Path) -> Stored:
    """Read a result and what its file tells of it, see `load_result`."""
    try:
        start = path.read_bytes()[:3]
    except OSError as error:
        raise ParameterError(
            f"{path} cannot be read ({error.strerror or error}): {_REMEDY}"
        ) from error
    try:
        return _from_netcdf(path) if start == b"CDF" else _from_json(path)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from error
    except (
        AttributeError,
        KeyError,
        IndexError,
        TypeError,
        ValueError,
        OSError,
        OverflowError,
        RecursionError,
    ) as error:
        raise ParameterError(
            f"{path} does not hold the result of a scenario ({type(error).__name__}: {error}): "
            f"{_REMEDY}"
        ) from error


def _from_json(path: Path) -> Stored:
    data = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise ParameterError(f"this is no result of a scenario in the format {FORMAT!r}: {_REMEDY}")
    del data["format"]
    provenance, run = _part(data, "provenance"), _part(data, "run")
    given, crank = _part(run, "signals", "run."), _part(run, "crank", "run.")
    arrays = {name: _array(_part(given, name, "signals.")) for name in given}
    if crank is not None:
        crank = {name: _array(item) for name, item in crank.items()}
    told = {key: value for key, value in data.items() if key != "provenance"}
    told["run"] = {key: value for key, value in run.items() if key not in ("signals", "crank")}
    return Stored(_result(told, provenance, arrays, crank), told)


def _from_netcdf(path: Path) -> Stored:
    import xarray as xr

    data: xr.Dataset = xr.load_dataset(path, engine="scipy", decode_times=False)
    attrs = data.attrs
    if attrs.get("format") != FORMAT:
        raise ParameterError(f"this is no result of a scenario in the format {FORMAT!r}: {_REMEDY}")
    dtypes = json.loads(_part(attrs, "dtypes"))
    arrays = {
        name: _cast(_part(data.variables, _plain(name)).values, str(dtype))
        for name, dtype in dtypes.items()
    }
    crank = None
    if any(str(name).startswith(_CRANK) for name in data.variables):
        of_trace = {name: _part(data.variables, _crank_name(name)) for name in _TRACE}
        crank = {name: _cast(values.values, "float64") for name, values in of_trace.items()}
    told = {
        "scenario": json.loads(_part(attrs, "scenario")),
        "seed": int(_part(attrs, "scenario_seed")),
        "met": json.loads(_part(attrs, "met")),
        "verdicts": json.loads(_part(attrs, "verdicts")),
        "run": {
            "name": _part(attrs, "run_name"),
            "n_cylinders": int(_part(attrs, "n_cylinders")),
            "seed": int(_part(attrs, "run_seed")),
            "faults": json.loads(_part(attrs, "run_faults")),
        },
    }
    return Stored(_result(told, json.loads(_part(attrs, "provenance")), arrays, crank), told)


def _result(
    told: Mapping[str, Any],
    provenance: Any,
    arrays: Mapping[str, np.ndarray],
    crank: Mapping[str, np.ndarray] | None,
) -> ScenarioResult:
    """Put a result together, after a check that all parts are there and fit each other."""
    from .scenario import Scenario

    for key in ("met", "verdicts"):
        _part(told, key)
    seed, numbers = _part(told, "seed"), _part(told, "run")
    run_of = {key: _part(numbers, key, "run.") for key in ("name", "n_cylinders", "seed")}
    faults = _part(numbers, "faults", "run.")
    unknown = sorted(set(arrays) - set(_SIGNALS))
    if unknown:
        raise ParameterError(f"signal {unknown[0]} is not known: {_REMEDY}")
    for name in _SIGNALS:
        _part(arrays, name, "signals.")
    size = arrays["time"].shape
    for name, values in arrays.items():
        if values.shape != size or len(size) != 1:
            raise ParameterError(
                f"signal {name} has shape {values.shape}, but time has {size}: the file is "
                f"damaged; {_REMEDY}"
            )
    if not isinstance(provenance, Mapping) or type(seed) is not int:
        raise ParameterError(
            f"seed is {seed!r} and provenance {type(provenance).__name__}, but must be a whole "
            f"number and an object: the file is damaged; {_REMEDY}"
        )
    which = Scenario.from_dict(_part(told, "scenario"))
    trace = None if crank is None else _trace(crank, which.true_engine)
    given: dict[str, Any] = {**run_of, **arrays}
    run = ClosedLoopResult(
        **given,
        faults=tuple(Fault.from_dict(fault) for fault in faults),
        trace=trace,
    )
    return ScenarioResult(which, run, seed, provenance)


def _trace(crank: Mapping[str, np.ndarray], engine: Engine) -> Trace:
    return Trace(**{name: _part(crank, name, "crank.") for name in _TRACE}, engine=engine)


def _part(data: Mapping[Any, Any], key: str, of: str = "") -> Any:
    """Value of a key of a file, which must be there."""
    if not isinstance(data, Mapping):
        raise ParameterError(
            f"{of.rstrip('.') or 'content'} is {data!r}, but must be an object: the file is "
            f"damaged; {_REMEDY}"
        )
    if key not in data:
        raise ParameterError(f"{of}{key} is missing: the file is damaged; {_REMEDY}")
    return data[key]


# -- numbers and text --------------------------------------------------------------------------


def _arrays(arrays: Mapping[str, np.ndarray]) -> str:
    return _lines(
        {
            name: _text({"dtype": str(values.dtype), "values": values})
            for name, values in arrays.items()
        }
    )


def _array(item: Mapping[str, Any]) -> np.ndarray:
    """Array of what `_arrays` wrote: null is NaN, and infinities are text."""
    values, dtype = item["values"], str(item["dtype"])
    if dtype.startswith("float"):
        return np.array(values, dtype=object).astype(float).astype(dtype)
    return _cast(np.array(values), dtype)


def _cast(values: np.ndarray, dtype: str) -> np.ndarray:
    """Array of a kind of number that results have, in the machine's byte order."""
    if np.dtype(dtype).kind not in "fib":
        raise ParameterError(f"dtype is {dtype!r}, but must be one of numbers: {_REMEDY}")
    return np.asarray(values).astype(dtype)


def _cell(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else repr(float(value))
    return str(int(value))


def _lines(parts: Mapping[str, str]) -> str:
    """JSON object of values that are JSON text, a line each."""
    return "{\n" + ",\n".join(f"{_text(key)}: {value}" for key, value in parts.items()) + "\n}"


def _text(value: Any) -> str:
    return json.dumps(jsonable(value), ensure_ascii=False, allow_nan=False)


def _plain(name: str) -> str:
    """Name of a field in a dataset: without its unit."""
    for suffix in _SUFFIXES:
        name = name.removesuffix(suffix)
    return name


def _crank_name(field: str) -> str:
    """Variable of a dataset that holds a field of a trace."""
    special = {"crank_angle_deg": "crank_angle", "time": _CLOCK}
    return special.get(field, f"{_CRANK}{_plain(field)}")
