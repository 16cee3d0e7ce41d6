"""How much of an uncertainty set a bound covers, and how sure that is: order statistics.

Let N samples be drawn independently from a set, and give each a score (how far a weight would
have to be scaled to cover it, say). Let the bound be the (k+1)-th largest score, so that k
samples are left out. The share of the set whose score is within the bound is then random, but
at least ``p`` with confidence ``gamma`` when

    I_p(N - k, k + 1) <= 1 - gamma,    that is    P(Binomial(N, 1 - p) <= k) <= 1 - gamma,

whatever the distribution of the scores (Wilks 1941); where scores tie, the confidence is
higher still. Without left-out samples, 99 % of the set with 99 % confidence needs 459.

How a weight gets its guarantee. Its *shape* is fitted on a design sample, which may be of low
discrepancy, since nothing is claimed from it. Its *scale* is then set on an independent
calibration sample, drawn at random. The shape is fixed before the calibration sample is drawn,
so the scores are independent and the theorem holds as it stands (split conformal prediction). A
*fresh* sample, which neither has seen, checks the claim: `check_fresh`.

What this does not say. The share is one of the declared box under a uniform density with
independent parameters. It is silent about a real engine whose parameters lie outside, crowd in
a corner or go together, and about effects that the full plant does not have. The confidence
is that of the procedure, over repeated calibration samples. The claim covers one score: to
claim several at once, take their largest.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from plant import ParameterError
from plant._checks import in_range, whole
from plant.kinematics import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_SAMPLES = 10**9


def covered_share(samples: int, confidence: float, left_out: int = 0) -> float:
    """Share of the set that is covered, with a confidence.

    Parameters
    ----------
    samples : int
        Independent samples, N.
    confidence : float
        Between 0 and 1.
    left_out : int
        Samples above the bound, k.
    """
    from scipy.stats import beta

    k = _check_left_out(samples, left_out)
    return float(beta.ppf(1.0 - _open("confidence", confidence), samples - k, k + 1))


def confidence_of(share: float, samples: int, left_out: int = 0) -> float:
    """Confidence with which a share of the set is covered."""
    from scipy.stats import binom

    k = _check_left_out(samples, left_out)
    return float(binom.sf(k, samples, 1.0 - _open("share", share)))


def samples_needed(share: float, confidence: float, left_out: int = 0) -> int:
    """Least number of samples that covers a share of the set with a confidence.

    Raises
    ------
    ParameterError
        If an argument is out of range, or more than a thousand million would be needed.
    """
    whole("left_out", left_out, 0, MOST_SAMPLES - 1)
    _open("share", share)
    _open("confidence", confidence)
    few, enough = left_out, left_out + 1  # the confidence grows with the number of samples
    while confidence_of(share, enough, left_out) < confidence:
        few, enough = enough, 2 * enough
        if enough > MOST_SAMPLES:
            raise ParameterError(
                f"share {share:g} with confidence {confidence:g} needs more than {few} samples: "
                "claim a smaller share"
            )
    while enough - few > 1:
        middle = (few + enough) // 2
        if confidence_of(share, middle, left_out) < confidence:
            few = middle
        else:
            enough = middle
    return enough


@dataclass(frozen=True, eq=False)
class ScoreBound:
    """Bound on a score, and the share of the set that it is claimed to cover.

    Attributes
    ----------
    value : float
        The bound; a score equal to it is inside.
    share : float
        Claimed share of the set, 1.
    confidence : float
        Confidence of the claim, 1.
    samples : int
        Calibration samples.
    left_out : int
        Calibration samples that were allowed above the bound.
    scores : ndarray (samples,)
        Calibration scores, sorted; inf for a plant that failed.
    """

    value: float
    share: float
    confidence: float
    samples: int
    left_out: int
    scores: FloatArray = field(repr=False)

    def __str__(self) -> str:
        """Return the claim in a sentence."""
        return (
            f"A score of {self.value:.4g} covers at least {_percent(self.share)} of the set with "
            f"{_percent(self.confidence)} confidence ({self.samples} independent samples, "
            f"{self.left_out} left out)."
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the claim as plain values."""
        return {
            "value": self.value,
            "claimed": self.share,
            "confidence": self.confidence,
            "samples": self.samples,
            "left_out": self.left_out,
        }


def bound_from_scores(
    scores: ArrayLike, *, confidence: float, share: float | None = None
) -> ScoreBound:
    """Return the lowest bound that supports a claim.

    Parameters
    ----------
    scores : array_like (samples,)
        Scores of independent samples; the larger, the worse. Infinity stands for a plant that
        failed: it lies outside any bound, and counts as left out.
    confidence : float
        Of the claim.
    share : float, optional
        Share to be claimed; as many samples are then left out as it allows. By default none
        is left out, and the share is what the number of samples supports.

    Raises
    ------
    ParameterError
        If a score is NaN or minus infinity, the samples are too few for the claim (the message
        says how many it needs), or more plants failed than may be left out.
    """
    ordered = _scores(scores)
    n = ordered.size
    _open("confidence", confidence)
    k = 0 if share is None else _most_left_out(n, _open("share", share), confidence)
    failed = int(np.isinf(ordered).sum())
    if failed > k:
        raise ParameterError(
            f"{failed} of {n} plants failed (score inf), but at most {k} may be left out: a bound "
            "over all would be infinite; mend the plants, or claim a smaller share"
        )
    claimed = covered_share(n, confidence) if share is None else float(share)
    return ScoreBound(float(ordered[n - 1 - k]), claimed, float(confidence), n, k, ordered)


@dataclass(frozen=True, eq=False)
class FreshCheck:
    """Check of a bound on samples that it has not seen.

    Attributes
    ----------
    bound : ScoreBound
        The bound.
    fresh_samples, fresh_inside : int
        Fresh samples, and how many of them are within the bound; a failed plant is outside.
    low, high : float
        Exact (Clopper-Pearson) interval of the covered share, two-sided, with the confidence
        of the bound.
    p_value : float
        Probability of as few inside or fewer, were the covered share exactly the claimed one.
    scores : ndarray (fresh_samples,)
        Fresh scores, sorted.
    """

    bound: ScoreBound
    fresh_samples: int
    fresh_inside: int
    low: float
    high: float
    p_value: float
    scores: FloatArray = field(repr=False)

    @property
    def observed(self) -> float:
        """Share of the fresh samples within the bound."""
        return self.fresh_inside / self.fresh_samples

    @property
    def consistent(self) -> bool:
        """Whether `p_value` is at least 1 - confidence.

        A bound that covers what it claims fails this with a probability of at most
        1 - confidence. Few fresh samples refute little: see the interval.
        """
        return self.p_value >= 1.0 - self.bound.confidence

    def __str__(self) -> str:
        """Return the finding in a sentence."""
        verdict = "which is consistent with" if self.consistent else "which contradicts"
        return (
            f"{self.fresh_inside} of {self.fresh_samples} fresh samples "
            f"({_percent(self.observed)}) are within the bound, {verdict} the claimed "
            f"{_percent(self.bound.share)} (p-value {self.p_value:.2g}; "
            f"{_percent(self.bound.confidence)} interval {_percent(self.low)} to "
            f"{_percent(self.high)})."
        )

    def to_dict(self) -> dict[str, Any]:
        """Return claim and finding as plain values."""
        return {
            "claimed": self.bound.share,
            "confidence": self.bound.confidence,
            "fresh_samples": self.fresh_samples,
            "fresh_inside": self.fresh_inside,
            "observed": self.observed,
            "interval_low": self.low,
            "interval_high": self.high,
            "p_value": self.p_value,
            "consistent": self.consistent,
            "bound": self.bound.value,
            "calibration_samples": self.bound.samples,
            "left_out": self.bound.left_out,
        }

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw which share of calibration and fresh samples is within a score; return the axes.

        Failed plants are in no score's reach: their curve ends below 1.
        """
        from plant._plotting import COLOURS, axes, styled

        with styled():
            ax = axes(ax)
            for scores, name, colour, style in (
                (self.bound.scores, "calibration", COLOURS[0], "-"),
                (self.scores, "fresh", COLOURS[1], "--"),
            ):
                finite = scores[np.isfinite(scores)]
                ax.step(
                    np.concatenate((finite[:1], finite)),
                    np.arange(finite.size + 1) / scores.size,
                    style,
                    where="post",
                    color=colour,
                    label=f"{name}, {scores.size} samples",
                )
            ax.axvline(self.bound.value, color="0.2", ls=":", label="bound")
            ax.axhline(self.bound.share, color="0.5", lw=1.0, ls="-.", label="claimed share")
            ax.set_xlabel("score (1)")
            ax.set_ylabel("share of the samples within (1)")
            ax.set_title(
                f"{self.fresh_inside} of {self.fresh_samples} fresh samples within the bound"
            )
            ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return ax


def check_fresh(bound: ScoreBound, fresh_scores: ArrayLike) -> FreshCheck:
    """Check a bound on independent samples that neither its shape nor its scale has seen.

    Parameters
    ----------
    bound : ScoreBound
        From `bound_from_scores`.
    fresh_scores : array_like (fresh_samples,)
        Scores; infinity for a plant that failed, which is outside.

    Raises
    ------
    ParameterError
        If a score is NaN or minus infinity, or there is none.
    """
    from scipy.stats import beta, binom

    scores = _scores(fresh_scores)
    n, inside = scores.size, int((scores <= bound.value).sum())
    tail = 0.5 * (1.0 - bound.confidence)
    return FreshCheck(
        bound,
        n,
        inside,
        0.0 if inside == 0 else float(beta.ppf(tail, inside, n - inside + 1)),
        1.0 if inside == n else float(beta.isf(tail, inside + 1, n - inside)),
        float(binom.cdf(inside, n, bound.share)),
        scores,
    )


def _most_left_out(samples: int, share: float, confidence: float) -> int:
    """Largest number of samples that may be left out for a claim."""
    from scipy.stats import binom

    # The smallest k whose tail reaches 1 - confidence; it may still meet it exactly.
    k = min(int(binom.ppf(1.0 - confidence, samples, 1.0 - share)), samples - 1)
    while k >= 0 and confidence_of(share, samples, k) < confidence:
        k -= 1
    if k < 0:
        raise ParameterError(
            f"{samples} samples are too few for a share of {share:g} with confidence "
            f"{confidence:g}: draw at least {samples_needed(share, confidence)}, or claim at most "
            f"{covered_share(samples, confidence):.4g}"
        )
    return k


def _scores(scores: ArrayLike) -> FloatArray:
    """Return scores sorted and read-only, after checking them."""
    values = np.array(scores, dtype=float)
    if values.ndim != 1 or not values.size:
        raise ParameterError(
            f"the scores have shape {values.shape}, but must be (samples,): one for each sample"
        )
    bad = np.flatnonzero(np.isnan(values) | np.isneginf(values))
    if bad.size:
        raise ParameterError(
            f"score {bad[0]} is {values[bad[0]]:g}, but must be a number, or inf for a plant that "
            "failed: no sample may be dropped"
        )
    values.sort()
    values.setflags(write=False)
    return values


def _check_left_out(samples: int, left_out: int) -> int:
    whole("samples", samples, 1, MOST_SAMPLES)
    return whole("left_out", left_out, 0, samples - 1, remedy="one sample must set the bound")


def _open(name: str, value: float) -> float:
    return in_range(name, value, 0.0, 1.0, "1", open_low=True, open_high=True)


def _percent(share: float) -> str:
    return f"{100.0 * share:.4g} %"
