import matplotlib
import numpy as np
import pytest

from camless_ctrl.report.chapter import Context
from camless_ctrl.report.chapters import scenarios as chapter
from camless_ctrl.report.chapters.run_pictures import BINS, light_picture
from camless_ctrl.report.content import Figure, Table, Text
from camless_ctrl.scenario_run import run_scenario
from camless_ctrl.shipped import shipped_scenario
from plant import Engine

matplotlib.use("agg")

CHOSEN = ("demand-step", "demand-step-no-jitter", "cylinder-deactivation", "three-cylinders")


@pytest.fixture(scope="module")
def rough():
    """The demand step with a bound that no valve with jitter can keep, but one without can."""
    scenario = shipped_scenario("demand-step")
    bar = scenario.requirements[0]
    tight = bar.from_dict({**bar.to_dict(), "bound": 0.6})
    return scenario.replace(requirements=(tight, *scenario.requirements[1:]))


@pytest.fixture(scope="module")
def content(narrow_design, rough):
    known = {name: shipped_scenario(name) for name in CHOSEN} | {"demand-step": rough}
    context = Context(engine=Engine.paper())
    context.shared("controller", lambda: narrow_design)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(chapter, "shipped_scenarios", lambda: known)
        return chapter.ScenariosChapter().compute(context)


def test_every_requirement_is_in_the_table_with_its_verdict(content, rough):
    (table,) = [block for block in content.blocks if isinstance(block, Table)]
    stated = [
        (scenario.name, requirement.name)
        for scenario in (rough, *map(shipped_scenario, CHOSEN[1:3]))
        for requirement in scenario.requirements
    ]
    assert [(row[0], row[1]) for row in table.rows] == stated
    verdicts = {(row[0], row[1]): row[7] for row in table.rows}
    assert [key for key, met in verdicts.items() if not met] == [stated[0]]


def test_misses_by_jitter_alone_are_told_and_not_counted(content):
    (table,) = [block for block in content.blocks if isinstance(block, Table)]
    assert table.rows[0][8].endswith("by jitter alone, not counted")
    assert "told but not counted (here: 1)." in str(content.blocks[1])
    (found,) = content.requirements
    assert found.requirement.name == "scenario-requirements"
    assert found.value == 0
    assert found.met
    assert "demand-step: first commanded events (jitter, not counted)" in found.note


def test_scenarios_of_another_engine_are_left_out_by_name(content):
    text = [str(block) for block in content.blocks if isinstance(block, Text)]
    assert "Left out, because their engine is not that of this report: three-cylinders." in text
    assert str(content.finding) == (
        "In 3 scenarios of the library (1760 events) 11 of 12 requirements are met; missed: 0, and "
        "by jitter alone 1."
    )


def test_pictures_are_drawn_of_what_was_run_and_hold_no_bitmaps(content):
    figures = {block.id: block for block in content.blocks if isinstance(block, Figure)}
    assert set(figures) == {"overview", "cylinder-deactivation"}
    for figure in figures.values():
        assert "<image" not in figure.svg
        assert str(figure.caption)


def test_an_engine_without_scenarios_meets_nothing_and_says_so(monkeypatch):
    known = {"three-cylinders": shipped_scenario("three-cylinders")}
    monkeypatch.setattr(chapter, "shipped_scenarios", lambda: known)
    content = chapter.ScenariosChapter().compute(Context())
    (found,) = content.requirements
    assert not found.met
    assert "Left out" in str(content.blocks[2])
    assert not any(isinstance(block, Table | Figure) for block in content.blocks)


def test_the_light_picture_loses_no_error(narrow_design):
    scenario = shipped_scenario("fault-maf-offset")
    result = run_scenario(scenario, narrow_design)
    run = result.run
    figure = light_picture(result)
    charge, error = figure.axes  # the speed is constant
    (band,) = error.collections
    off = 100.0 * (run.charge / run.demand - 1.0)[run.time >= 0.0]
    _, low, _, high = band.get_paths()[0].get_extents().extents
    assert (low, high) == (pytest.approx(np.nanmin(off)), pytest.approx(np.nanmax(off)))
    demand = next(line for line in charge.lines if line.get_label() == "demand")
    time, drawn = demand.get_data()
    assert time.size <= BINS
    steady = np.isclose(drawn, 250.0) | np.isclose(drawn, 320.0)
    assert (~steady).sum() <= 2  # bins in which the demand steps
    assert "maf-offset" in charge.get_legend_handles_labels()[1]
    matplotlib.pyplot.close(figure)
