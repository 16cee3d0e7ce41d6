from __future__ import annotations

import json
import math

import pytest

from plant.errors import ParameterError
from plant.parameters import Engine
from plant.published import PUBLISHED_CLAIMS
from plant.validation import KNOWN_EXCEPTIONS, validate


@pytest.fixture(scope="module")
def report():
    return validate()


@pytest.fixture(scope="module")
def report_at_printed_temperature():
    return validate(Engine.paper().replace(temperature=316.0))


def test_nine_figures_within_two_percent_and_rms(report):
    met = [row for row in report.figures if row.id != "throttled-fig5"]
    assert len(met) == 9
    errors = [row.computed / row.published - 1.0 for row in met]
    assert max(abs(error) for error in errors) <= 0.02
    rms = math.sqrt(sum(error**2 for error in errors) / 9)
    assert rms <= 0.007
    assert report.rms == pytest.approx(rms)
    assert all(row.reproduced for row in met)
    assert report.holds
    assert report.failures == ()


def test_throttled_row_is_shown_as_not_reproduced_with_what_is(report):
    charge, loss = (row for row in report.figures if row.id == "throttled-fig5")
    assert not charge.reproduced
    assert not loss.reproduced
    assert charge.computed < 0.5 * charge.published
    for row in (charge, loss):
        assert row.note.startswith("not reproduced, because Eq. 19")
        assert "22.8 deg" in row.note
    equal = report.equal_charge
    assert equal.charge_mg == pytest.approx(171.0, abs=0.01)
    # found with two independent programs
    assert equal.throttle_deg == pytest.approx(22.8, abs=0.05)
    assert equal.loss_J == pytest.approx(15.2, abs=0.05)
    assert equal.saving == pytest.approx(0.77, abs=0.005)


def test_equal_charge_obeys_the_throttle_equation(report):
    # Four cylinders a cycle of 0.08 s take 4 * 171 mg = 8.55 g/s. The manifold is below half
    # of ambient pressure at such a load, so Eq. 15 is sonic: the flow is A_phi itself.
    phi = report.equal_charge.throttle_deg
    area = 1.268e-4 * (-0.2215 - 2.275 * phi + 0.23 * phi**2)
    assert area == pytest.approx(4 * 171e-6 / 0.08, rel=2e-3)


def test_every_claim_has_a_computed_verdict(report):
    assert [claim.id for claim in report.claims] == [claim.id for claim in PUBLISHED_CLAIMS]
    for claim in report.claims:
        assert claim.measured
        assert all(math.isfinite(entry.value) for entry in claim.measured.values())
        assert len(claim.why) > 20
        assert "eproduced if" in claim.definition
    unmet = {claim.id for claim in report.claims if not claim.reproduced}
    assert unmet <= set(KNOWN_EXCEPTIONS)
    assert set(report.known_exceptions) == {"throttled-fig5", *KNOWN_EXCEPTIONS}


def test_saturation_at_5500_rpm_is_not_reproduced(report):
    # charge at 5 mm about 86 % of that at 8 mm: found with two independent programs
    claim = next(claim for claim in report.claims if claim.id == "saturation-5500")
    share = claim.measured["charge_at_printed_lift_over_charge_at_8_mm"].value
    assert share == pytest.approx(0.86, abs=0.01)
    assert not claim.reproduced


def test_printed_temperature_is_four_to_nine_percent_low(report, report_at_printed_temperature):
    errors = [row.relative_error for row in report.printed_temperature]
    assert len(errors) == 9
    assert min(errors) > -0.09
    assert max(errors) < -0.035
    # the same nine, met nowhere, when the engine itself has the printed temperature
    other = report_at_printed_temperature
    assert [row.relative_error for row in other.figures if not row.known_exception] == errors
    assert not any(row.reproduced for row in other.figures)
    assert not other.holds
    assert any("rms" in failure for failure in other.failures)
    assert sum("must be within 2 %" in failure for failure in other.failures) == 9


def test_without_runners_the_ram_effect_is_gone():
    steps = []
    report = validate(runner=False, progress=lambda done, total: steps.append((done, total)))
    verdicts = {claim.id: claim.reproduced for claim in report.claims}
    assert not verdicts["helmholtz-ram"]
    assert not report.holds
    assert any("helmholtz-ram" in failure for failure in report.failures)
    assert report.options["runner"] is False
    total = steps[0][1]
    assert steps == [(k, total) for k in range(1, total + 1)]


def test_json_holds_what_is_asked_of_it(report):
    content = json.loads(report.to_json())
    assert len(content["published"]) == 11
    for row in content["published"]:
        assert {"id", "quantity", "published", "computed", "relative_error", "reproduced"} <= set(
            row
        )
        assert row["relative_error"] == pytest.approx(row["computed"] / row["published"] - 1.0)
    assert len(content["claims"]) == 11
    for claim in content["claims"]:
        assert {"id", "reproduced", "measured", "why"} <= set(claim)
        assert all(set(entry) == {"value", "unit"} for entry in claim["measured"].values())
    assert content["holds"] is True
    assert content["engine"]["temperature"] == 290.0


def test_text_names_every_row(report):
    text = str(report)
    for row in (*report.figures, *report.claims):
        assert row.id in text
    assert text.count("NOT reproduced") == sum(
        not row.reproduced for row in (*report.figures, *report.claims)
    )


def test_plot_draws_every_figure(report):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    ax = report.plot()
    assert len(ax.get_yticks()) == 11
    drawn = {(float(line.get_xdata()[0]), float(line.get_ydata()[0])) for line in ax.lines}
    for k, row in enumerate(report.figures[:9]):
        assert (100.0 * row.relative_error, k) in drawn
    assert any("-59 %" in text.get_text() for text in ax.texts)
    plt.close(ax.figure)


def test_refuses_what_is_not_an_engine():
    with pytest.raises(ParameterError, match="must be an Engine"):
        validate("paper")
