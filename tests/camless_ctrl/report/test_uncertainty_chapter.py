import matplotlib
import pytest

from camless_ctrl.report.chapter import Context
from camless_ctrl.report.chapters import uncertainty as chapter
from camless_ctrl.report.content import Figure, Table
from plant import CrankAnglePlant, Engine, MeanValuePlant
from plant.region import OperatingPoint
from uncertainty import attribute, quantify, tornado

matplotlib.use("agg")
POINTS = (OperatingPoint(1500.0, 3.0, 120.0), OperatingPoint(1600.0, 3.0, 120.0))


@pytest.fixture(scope="module")
def result():
    patch = pytest.MonkeyPatch()
    context = Context(engine=Engine.paper())
    maps = MeanValuePlant.fit(
        CrankAnglePlant(),
        speed_range_rpm=(1400.0, 1700.0),
        lift_range_mm=(2.5, 3.5),
        tolerance=0.02,
        most_points=800,
    )
    found = quantify(maps=maps, points=POINTS, share=0.8, confidence=0.8, design=8, fresh=30)
    context.shared("quantification", lambda: found)
    patch.setattr(
        chapter, "attribute", lambda plant, seed: attribute(plant, points=POINTS, samples=64)
    )
    patch.setattr(chapter, "tornado", lambda plant: tornado(plant, points=POINTS))
    yield found, chapter.UncertaintyChapter().compute(context)
    patch.undo()


def test_the_chapter_tells_what_was_found(result):
    found, content = result
    assert f"{found.coverage.fresh_inside} of 30 fresh full plants" in str(content.finding)
    table = next(b for b in content.blocks if isinstance(b, Table) and "weights" in b.id)
    assert [row[0] for row in table.rows] == [c.channel.name for c in found.channels]
    assert [row[3] for row in table.rows] == [c.check.min_ratio for c in found.channels]
    names = {r.requirement.name: r for r in content.requirements}
    assert names.keys() == {"uncertainty-weights", "uncertainty-coverage"}
    assert names["uncertainty-weights"].value == found.least_ratio
    assert names["uncertainty-coverage"].value == found.coverage.p_value


def test_figures_say_what_they_show_and_hold_no_bitmaps(result):
    _, content = result
    figures = [block for block in content.blocks if isinstance(block, Figure)]
    assert len(figures) == 4
    for figure in figures:
        assert "<image" not in figure.svg
        assert str(figure.caption)
