import io
import re
from xml.etree import ElementTree

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from camless_ctrl.report.figures import svg
from plant._plotting import styled

matplotlib.use("agg")


def test_curves_stay_within_a_hundredth_of_a_point_and_take_little_space():
    x = np.linspace(0.0, 10.0, 41)
    y = np.sin(3.0 * x)
    figure = Figure(figsize=(4.0, 3.0))
    ax = figure.add_subplot()
    ax.plot(x, y, gid="curve")
    text = svg(figure, "f1")
    (path,) = re.findall(r'id="f1-curve">\s*<path d="([^"]*)"', text)
    found = np.array([float(n) for n in re.findall(r"-?[\d.]+", path)]).reshape(-1, 2)
    # The axes are linear: what is left of a straight line is the rounding.
    for values, place in ((x, found[:, 0]), (y, found[:, 1])):
        line = np.polynomial.Polynomial.fit(values, place, 1)
        assert np.abs(line(values) - place).max() < 0.008
    assert not re.search(r"\.\d{3}", path)


def test_what_is_left_out_for_space_is_seen_by_nobody():
    def made():
        with styled():
            figure = Figure(figsize=(4.0, 3.0))
            ax = figure.add_subplot()
            ax.plot([0.0, 1.0], [0.0, 1.0])
            ax.set_title("two\n  -- lines --> and <more>")
        return figure

    with styled(), io.StringIO() as buffer:
        made().savefig(buffer, format="svg")
        whole = buffer.getvalue()
    text = svg(made(), "f1")
    assert "<!--" not in text
    assert not re.search(r"^[ \t]|[ \t]$", text, re.MULTILINE)
    drawn, kept = (
        [
            (element.tag, element.get("transform"), element.get("style"))
            for element in ElementTree.fromstring(page).iter()
            if element.tag.endswith(("}path", "}use", "}g"))
        ]
        for page in (whole[whole.index("<svg") :], text)
    )
    assert len(drawn) > 50
    assert kept == drawn
