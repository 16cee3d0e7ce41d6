import re
from pathlib import Path

import matplotlib as mpl

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def test_the_example_runs_as_printed(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # it saves maps
    mpl.use("agg")
    examples = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    names = {}
    exec("\n".join(examples), names)  # our own text
    # Figure 4 of the paper prints 473 mg for this event
    assert abs(1e6 * names["cycle"].air_charge[0] / 473.0 - 1.0) < 0.02
    assert names["maps"].air_charge.dims == ("speed_rpm", "duration_deg", "cylinder")
    assert (tmp_path / "maps.nc").stat().st_size > 0
    assert names["inverse"].reachable
    assert "charge" in capsys.readouterr().out


def test_the_commands_named_exist():
    from camless_ctrl.cli._app import _COMMANDS

    (listed,) = re.findall(r"`camless (\w+(?: \| \w+)+)`", README)
    assert listed.split(" | ") == list(_COMMANDS)
