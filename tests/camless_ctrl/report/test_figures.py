import re

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from camless_ctrl.report.figures import svg

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
