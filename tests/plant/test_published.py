from __future__ import annotations

import pytest

from plant.errors import ParameterError
from plant.published import PUBLISHED_CLAIMS, PUBLISHED_POINTS, published_point


def test_table_of_section_4_as_printed():
    # N, model charge, measured charge, model loss, measured loss; the second row is printed
    # with 3500 for N, the text and Figure 7 say 3000.
    printed = [
        (1500, 477.4, 506.9, 5.2, 5.7),
        (3000, 503.3, 545.6, 8.9, 7.9),
        (4000, 493, 545.6, 12.3, 13.0),
    ]
    rows = [p for p in PUBLISHED_POINTS if p.section == "4"]
    assert [
        (p.speed_rpm, p.charge_mg, p.measured_charge_mg, p.loss_J, p.measured_loss_J) for p in rows
    ] == printed
    for point in rows:
        assert point.profile == "conventional"
        assert point.command.lift_mm == 8.1
        assert point.command.opening_deg == -8  # 8 deg BTDC
        assert point.command.closing_deg == 180 + 46  # 46 deg ABDC
        assert point.throttle_deg == 90
    assert "3500" in published_point("cam-3000").note


def test_points_of_section_3_as_printed():
    fig4 = published_point("camless-fig4")
    assert (fig4.speed_rpm, fig4.command.lift_mm, fig4.command.duration_deg) == (1500, 3, 189)
    assert fig4.charge_mg == pytest.approx(1e3 * 0.473)  # "0.473 g/event"
    assert fig4.loss_J is None
    fig5 = published_point("camless-fig5")
    assert (fig5.speed_rpm, fig5.command.lift_mm, fig5.command.duration_deg) == (1500, 2, 99)
    assert fig5.charge_mg == pytest.approx(1e6 * 1.71e-4)
    assert fig5.loss_J == 3.55
    throttled = published_point("throttled-fig5")
    assert (throttled.throttle_deg, throttled.charge_mg, throttled.loss_J) == (17, 171, 13.8)
    # the printed losses are those of the printed 74 %
    assert 1 - fig5.loss_J / throttled.loss_J == pytest.approx(0.74, abs=0.005)


def test_eleven_model_figures_and_six_measured_ones():
    figures = [figure for point in PUBLISHED_POINTS for figure in point.figures]
    assert len(figures) == 11
    assert sum(figure.measured is not None for figure in figures) == 6
    assert {(f.quantity, f.unit) for f in figures} == {("air_charge", "mg"), ("pumping_loss", "J")}
    unmet = {figure.point.id for figure in figures if figure.point.known_exception}
    assert unmet == {"throttled-fig5"}


def test_claims():
    assert len({claim.id for claim in PUBLISHED_CLAIMS}) == len(PUBLISHED_CLAIMS) == 11
    lifts = {c.speed_rpm: c.lift_mm for c in PUBLISHED_CLAIMS if c.lift_mm is not None}
    assert lifts == {750: 1.5, 1500: 3, 5500: 5}  # section 5


def test_unknown_point_names_the_nearest():
    with pytest.raises(ParameterError, match="cam-1500"):
        published_point("cam-150")
