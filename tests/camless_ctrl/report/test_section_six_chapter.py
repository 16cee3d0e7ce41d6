import re

import pytest

from camless_ctrl.report import Context, Figure, Table, build_report
from camless_ctrl.report.chapter import Chapter
from camless_ctrl.report.chapters.section_six import SectionSixChapter
from plant import CrankAnglePlant, Engine, ValveCommand


@pytest.fixture(scope="module")
def result():
    return SectionSixChapter().compute(Context())


def test_it_is_a_chapter():
    chapter = SectionSixChapter()
    assert isinstance(chapter, Chapter)
    assert (chapter.id, chapter.title) == ("section-six", "Section 6 redrawn")
    assert chapter.concludes is False


def test_four_figures_stand_in_the_paper_s_order_and_are_drawn_by_lines(result):
    figures = [block for block in result.blocks if isinstance(block, Figure)]
    assert [figure.id for figure in figures] == [f"figure-{k}" for k in (11, 12, 13, 14)]
    for figure in figures:
        assert figure.alt
        assert "<image" not in figure.svg
        assert "data:image" not in figure.svg
        assert "<path" in figure.svg


def test_captions_carry_the_numbers_of_single_cycles(result):
    charges = []
    for runner in (False, True):
        plant = CrankAnglePlant(runner=runner)
        charges.append(float(plant.steady_cycle(6000.0, ValveCommand(7.0, 266.0)).air_charge[0]))
    numbers = result.all_numbers
    assert numbers["figure_13_ivc230_charge_without"].value == pytest.approx(1e6 * charges[0])
    assert numbers["figure_13_ivc230_charge_with"].unit == "mg"
    change = 100.0 * (charges[1] / charges[0] - 1.0)
    assert numbers["figure_13_ivc230_charge_change"].value == pytest.approx(change, abs=1e-4)
    loops = next(b for b in result.blocks if isinstance(b, Figure) and b.id == "figure-13")
    assert f"{change:+.1f}\u00a0%" in str(loops.caption)
    assert "closing at 230°" in str(loops.caption)


def test_the_table_shows_every_statement_with_number_bound_and_verdict(result):
    table = next(block for block in result.blocks if isinstance(block, Table))
    assert len(table.rows) == int(result.numbers["judged"].value)
    held = [row for row in table.rows if row[-1] is True]
    assert len(held) == int(result.numbers["held"].value)
    by_statement = {(row[0], row[1]): row for row in table.rows}
    row = by_statement["Figure 12", 'late closing: "no adverse effect in specific pumping losses"']
    assert row[-1] is False
    assert f"{row[3]:+.0f}\u00a0%" in str(result.finding)
    for row in table.rows:
        kind, bound = re.match(r"(at most|at least) (-?[\d.]+) %, \w", row[4]).groups()
        inside = row[3] <= float(bound) if kind == "at most" else row[3] >= float(bound)
        assert row[-1] is inside


def test_another_engine_can_be_reported():
    six = Engine.paper().replace(n_cylinders=6)
    found = SectionSixChapter().compute(Context(engine=six))
    cycle = CrankAnglePlant(six).steady_cycle(6000.0, ValveCommand(7.0, 216.0))
    charge = found.all_numbers["figure_13_ivc180_charge_with"].value
    assert charge == pytest.approx(1e6 * float(cycle.air_charge[0]), rel=1e-6)


def test_it_stands_in_a_report(tmp_path):
    report = build_report(tmp_path, chapters=[SectionSixChapter()], context=Context())
    page = report.page.read_text(encoding="utf-8")
    assert report.chapters[0].error == ""
    assert "Section 6 redrawn" in page
    assert page.count("<svg") == 4
    assert "not confirmed" in page
    assert "nan" not in re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL).lower().split()
