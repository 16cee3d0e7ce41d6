import matplotlib
import pytest

from camless_ctrl import robust_analysis
from camless_ctrl.delay_boundary import delay_boundary
from camless_ctrl.report.chapter import Context
from camless_ctrl.report.chapters import other_laws
from camless_ctrl.report.chapters import structured as chapter
from camless_ctrl.report.content import Figure, Table, Text
from camless_ctrl.requirements import REQUIREMENTS
from camless_ctrl.synthesis import SynthesisError
from plant import Engine

matplotlib.use("agg")


@pytest.fixture(scope="module")
def result(narrow_design):
    context = Context(engine=Engine.paper())
    context.shared("mean_value", lambda: narrow_design.maps)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(robust_analysis, "LTI_SAMPLES", 50)
        found = robust_analysis.analyse_robustness(narrow_design, (1500.0,), samples=3)
        context.shared("structured", lambda: found)

        def few_runs(feedforward, **options):
            return delay_boundary(
                feedforward, speeds_rpm=(1500.0,), simulated=((1500.0, 2),), cycles=25, **options
            )

        patch.setattr(chapter, "delay_boundary", few_runs)
        yield found, chapter.StructuredRobustnessChapter().compute(context)


def tables(content):
    return {block.id: block for block in content.blocks if isinstance(block, Table)}


def test_the_tables_hold_what_was_found(result):
    found, content = result
    (row,) = tables(content)["structured-verdicts"].rows
    (speed,) = found.speeds
    assert row[0] == 1500.0
    assert row[1] is speed.structured.robust_performance
    assert row[2] == speed.structured.margin
    (tight,) = tables(content)["structured-tight"].rows
    assert tight[1:3] == [speed.gain_break.predicted, speed.gain_break.simulated]
    assert isinstance(tight[-1], bool)
    (margins,) = tables(content)["structured-margins"].rows
    gains = found.schedule.at(1500.0)
    assert margins[1:3] == [gains.mean, gains.imbalance]
    assert "1 of 1 speeds" in str(content.finding)


def test_the_laws_are_compared_with_the_controllers_own(result):
    _, content = result
    own, designed, synthesised = tables(content)["laws-table"].rows
    assert own[0] == "own law"
    assert designed[0] == "designed gains"
    assert synthesised[0].endswith("(LTI)")
    assert own[2] is designed[2] is synthesised[2] is True
    assert own[7] < designed[7]  # noise: what the law's small gains are for


def test_the_requirements_are_those_of_the_controllers_loop(result):
    found, content = result
    names = {r.requirement.name: r for r in content.requirements}
    assert names.keys() == {name for name in REQUIREMENTS if name.startswith("loop-")}
    assert len(content.requirements) == len(names)
    assert names["loop-robust-performance"].value == found.speeds[0].structured.performance.ceiling
    assert names["loop-sound"].value == 0
    assert names["loop-tight"].met


def test_figures_hold_no_bitmaps(result):
    _, content = result
    figures = [block for block in content.blocks if isinstance(block, Figure)]
    assert len(figures) == 6
    assert not any("<image" in figure.svg for figure in figures)


def test_the_simple_estimators_are_told_apart_from_the_controllers_loop(result):
    _, content = result
    texts = [str(block) for block in content.blocks if isinstance(block, Text)]
    assert any("not about the controller's loop" in text for text in texts)


def test_the_analysis_prints_and_is_sound(result):
    found, _ = result
    assert found.sound
    text = str(found)
    assert "contradict it" in text
    assert "the full plant with" in text
    (record,) = found.records()
    assert record["confirmed"]["sampled_plant"] == 3


def test_the_laws_are_compared_without_the_one_that_fails(result, monkeypatch):
    found, _ = result

    def none(measurement, paces, confirm):
        raise SynthesisError("no law settles")

    monkeypatch.setattr(other_laws, "mu_optimal_law", none)
    blocks = other_laws.other_laws(Context(engine=Engine.paper()), found, 1500.0)
    (table,) = (block for block in blocks if isinstance(block, Table))
    assert [row[0] for row in table.rows] == ["own law", "designed gains"]
    assert str(blocks[-1]) == "No law was found by synthesis: no law settles"


def test_a_design_that_fails_is_told_and_does_not_end_the_chapter(result, monkeypatch):
    found, _ = result

    def none(measurements, present, confirm):
        raise SynthesisError("no gain keeps |S| below 2")

    monkeypatch.setattr(other_laws, "design_schedule", none)
    (text,) = other_laws.other_laws(Context(engine=Engine.paper()), found, 1500.0)
    assert str(text) == "No other law was found: no gain keeps |S| below 2"
