import pytest

from camless_ctrl.report import Context, Figure, Table
from camless_ctrl.report.chapters.deltas import DeltasChapter
from plant import Engine
from uncertainty.deltas import evaluate_all


@pytest.fixture(scope="module")
def deltas():
    return evaluate_all(
        speeds_rpm=(1500.0, 3000.0, 6000.0),
        lifts_mm=(2.0, 5.0),
        durations_deg=(120.0, 180.0, 260.0),
    )


@pytest.fixture(scope="module")
def chapter(deltas):
    import matplotlib

    matplotlib.use("agg")
    context = Context()
    context.shared("deltas", lambda: deltas)
    return DeltasChapter().compute(context)


def block(chapter, id):
    (found,) = (b for b in chapter.blocks if getattr(b, "id", "") == id)
    return found


def test_the_finding_tells_the_worst_changes(deltas, chapter):
    numbers = chapter.all_numbers
    data = deltas["Helmholtz runner"].dataset.charge
    assert numbers["helmholtz_any_charge"].value == pytest.approx(100.0 * float(abs(data).max()))
    identified = float(abs(data.sel(case="runner")).max())
    assert numbers["helmholtz_charge"].value == pytest.approx(100.0 * identified)
    assert f"{100.0 * identified:.0f}" in str(chapter.finding)
    assert f"{abs(100.0 * deltas.joint.interaction('charge').value):.0f}" in str(chapter.finding)


def test_the_tables_hold_the_results(deltas, chapter):
    worst = block(chapter, "worst")
    assert isinstance(worst, Table)
    assert [row[0] for row in worst.rows[::2]] == [
        "Helmholtz runner",
        "Actuator oscillation",
        "Parameters",
        "Sensors",
        "Sum",
        "All at once",
    ]
    for row, result in zip(worst.rows[::2], deltas, strict=True):
        assert row[2] == pytest.approx(100.0 * float(result.dataset.charge.min()))
        assert row[3] == pytest.approx(100.0 * float(result.dataset.charge.max()))
        assert row[5] == result.worst_charge.case
    last = block(chapter, "interaction").rows[-1]
    at = deltas.joint.dataset.sel(speed=6000.0)
    assert last[0] == 6000.0
    assert last[3:7] == pytest.approx(
        [
            100.0 * float(v)
            for v in (
                at.charge.min(),
                at.charge.max(),
                at.interaction_charge.min(),
                at.interaction_charge.max(),
            )
        ]
    )


def test_the_modes_are_those_of_a_lag_of_10_and_20_ms(chapter):
    # At 6000 rpm a wrong lag makes 1.46 and 0.76 of the gain of mode 1.
    rows = {(row[0], row[1]): row for row in block(chapter, "modes").rows}
    assert rows[(6000.0, 1)][3:5] == pytest.approx([1.46, 0.76], abs=0.005)
    assert len(rows) == 8


def test_the_figures_are_small_and_hold_no_picture(chapter):
    figures = [b for b in chapter.blocks if isinstance(b, Figure)]
    assert [f.id for f in figures] == [
        "helmholtz",
        "helmholtz-map",
        "oscillation",
        "oscillation-map",
    ]
    for figure in figures:
        assert len(figure.svg) < 100_000
        assert "<image" not in figure.svg


def test_an_engine_of_three_cylinders_has_one_imbalance_mode(deltas):
    context = Context(engine=Engine.paper().replace(n_cylinders=3))
    context.shared("deltas", lambda: deltas)
    chapter = DeltasChapter().compute(context)
    assert {row[1] for row in block(chapter, "modes").rows} == {1}
