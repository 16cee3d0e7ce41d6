import matplotlib
import pytest

from camless_ctrl import robust_analysis
from camless_ctrl.delay_boundary import delay_boundary
from camless_ctrl.law_comparison import standard_laws
from camless_ctrl.report.chapter import Context
from camless_ctrl.report.chapters import structured as chapter
from camless_ctrl.report.content import Figure, Table
from camless_ctrl.synthesis import SynthesisError
from plant import CrankAnglePlant, Engine, MeanValuePlant

matplotlib.use("agg")


@pytest.fixture(scope="module")
def result():
    patch = pytest.MonkeyPatch()
    patch.setattr(robust_analysis, "LTI_SAMPLES", 50)
    context = Context(engine=Engine.paper())
    maps = MeanValuePlant.fit(
        CrankAnglePlant(),
        speed_range_rpm=(1400.0, 1700.0),
        lift_range_mm=(2.5, 3.5),
        tolerance=0.02,
        most_points=800,
    )
    context.shared("mean_value", lambda: maps)
    found = robust_analysis.analyse_robustness(maps, (1500.0,), samples=3)
    context.shared("structured", lambda: found)

    def two_laws(measurement):
        laws = standard_laws(measurement)
        return {name: laws[name] for name in ("present gains", "H-infinity")}

    def few_runs(feedforward, **options):
        return delay_boundary(
            feedforward, speeds_rpm=(1500.0,), simulated=((1500.0, 2),), cycles=25, **options
        )

    patch.setattr(chapter, "standard_laws", two_laws)
    patch.setattr(chapter, "delay_boundary", few_runs)
    yield found, chapter.StructuredRobustnessChapter().compute(context)
    patch.undo()


def test_the_tables_hold_what_was_found(result):
    found, content = result
    tables = {block.id: block for block in content.blocks if isinstance(block, Table)}
    (row,) = tables["structured-verdicts"].rows
    (speed,) = found.speeds
    assert row[0] == 1500.0
    assert row[1] is speed.structured.robust_performance
    assert row[2] == speed.structured.margin
    (tight,) = tables["structured-tight"].rows
    assert tight[2:4] == [speed.tightness.predicted, speed.tightness.simulated]
    assert isinstance(tight[-1], bool)
    assert [r[0] for r in tables["laws-table"].rows] == ["present gains", "H-infinity"]
    assert "1 of 1 speeds" in str(content.finding)


def test_the_requirements_are_those_of_the_structured_analysis(result):
    found, content = result
    names = {r.requirement.name: r for r in content.requirements}
    assert names.keys() == {
        "loop-robust-performance",
        "loop-sound",
        "loop-tight",
        "loop-coverage",
    }
    assert names["loop-robust-performance"].value == found.speeds[0].structured.performance.ceiling
    assert names["loop-sound"].value == 0


def test_figures_hold_no_bitmaps(result):
    _, content = result
    figures = [block for block in content.blocks if isinstance(block, Figure)]
    assert len(figures) == 7
    assert not any("<image" in figure.svg for figure in figures)


def test_the_analysis_prints_and_is_sound(result):
    found, _ = result
    assert found.sound
    text = str(found)
    assert "contradict it" in text
    assert "the full plant breaks at" in text
    (record,) = found.records()
    assert record["confirmed"]["sampled_plant"] == 3


def test_a_synthesis_that_fails_is_told_and_does_not_end_the_chapter(result, monkeypatch):
    found, _ = result

    def none(measurements, confirm):
        raise SynthesisError("no gain keeps |S| below 2")

    monkeypatch.setattr(chapter, "design_schedule", none)
    (text,) = chapter._other_laws(Context(engine=Engine.paper()), found)
    assert str(text) == "No other law was found: no gain keeps |S| below 2"
