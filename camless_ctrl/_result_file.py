"""Results of scenarios in files: CSV, netCDF and JSON, the latter two to be read again."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
_FIELDS = {field.name for field in dataclasses.fields(ClosedLoopResult)}
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
    found = {name: getattr(run, name) for name in sorted(_FIELDS)}
    return {name: value for name, value in found.items() if isinstance(value, np.ndarray)}


def trace_signals(run: ClosedLoopResult) -> dict[str, np.ndarray]:
    """Return the arrays over the crank angle by their field; none if not recorded."""
    if run.trace is None:
        return {}
    return {name: np.asarray(getattr(run.trace, name)) for name in _TRACE}


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
            }
        )
        for name in ("name", "seed"):
            data.attrs.pop(name, None)
        data.to_netcdf(place, engine="scipy")


# -- reading -----------------------------------------------------------------------------------


def read(path: Path) -> ScenarioResult:
    """See `load_result`."""
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


def _from_json(path: Path) -> ScenarioResult:
    data = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise ParameterError(f"this is no result of a scenario in the format {FORMAT!r}: {_REMEDY}")
    run = data["run"]
    arrays = {name: _array(item) for name, item in run["signals"].items()}
    crank = run["crank"] and {name: _array(item) for name, item in run["crank"].items()}
    return _result(
        data["scenario"],
        data["seed"],
        data["provenance"],
        {"name": run["name"], "n_cylinders": run["n_cylinders"], "seed": run["seed"]},
        run["faults"],
        arrays,
        crank,
    )


def _from_netcdf(path: Path) -> ScenarioResult:
    import xarray as xr

    data: xr.Dataset = xr.load_dataset(path, engine="scipy", decode_times=False)
    attrs = data.attrs
    if attrs.get("format") != FORMAT:
        raise ParameterError(f"this is no result of a scenario in the format {FORMAT!r}: {_REMEDY}")
    dtypes = json.loads(attrs["dtypes"])
    arrays = {name: _cast(data[_plain(name)].values, str(dtype)) for name, dtype in dtypes.items()}
    crank = None
    if _CLOCK in data.variables:
        crank = {name: _cast(data[_crank_name(name)].values, "float64") for name in _TRACE}
    return _result(
        json.loads(attrs["scenario"]),
        int(attrs["scenario_seed"]),
        json.loads(attrs["provenance"]),
        {
            "name": attrs["run_name"],
            "n_cylinders": int(attrs["n_cylinders"]),
            "seed": int(attrs["run_seed"]),
        },
        json.loads(attrs["run_faults"]),
        arrays,
        crank,
    )


def _result(
    scenario: Mapping[str, Any],
    seed: Any,
    provenance: Any,
    numbers: Mapping[str, Any],
    faults: Any,
    arrays: Mapping[str, np.ndarray],
    crank: Mapping[str, np.ndarray] | None,
) -> ScenarioResult:
    """Put a result together, after a check that the parts fit each other."""
    from .scenario import Scenario

    unknown = sorted(set(arrays) - _FIELDS)
    if unknown:
        raise ParameterError(f"signal {unknown[0]} is not known: {_REMEDY}")
    size = arrays["time"].shape
    for name, values in arrays.items():
        if values.shape != size or len(size) != 1:
            raise ParameterError(
                f"signal {name} has shape {values.shape}, but time has {size}: the file is "
                f"damaged; {_REMEDY}"
            )
    if not isinstance(provenance, Mapping) or type(seed) is not int:
        raise ParameterError(f"seed or provenance are missing: the file is damaged; {_REMEDY}")
    which = Scenario.from_dict(scenario)
    trace = None if crank is None else _trace(crank, which.true_engine)
    given: dict[str, Any] = {**numbers, **arrays}
    run = ClosedLoopResult(
        **given,
        faults=tuple(Fault.from_dict(fault) for fault in faults),
        trace=trace,
    )
    return ScenarioResult(which, run, seed, provenance)


def _trace(crank: Mapping[str, np.ndarray], engine: Engine) -> Trace:
    return Trace(**{name: crank[name] for name in _TRACE}, engine=engine)


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
