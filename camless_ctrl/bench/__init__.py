"""The benchmark: the plant's kernel beside general solvers, on the same right-hand side."""

from .comparison import Comparison, MatchedSetting, PeerFigures
from .kernel_timing import KernelFigures, KernelSurvey
from .peers import Peer, installed_peers
from .points import BenchPoint, random_point, random_points
from .reference import Reference, solve_reference
from .result import BenchResult
from .run import BenchOptions, run_bench

__all__ = [
    "BenchOptions",
    "BenchPoint",
    "BenchResult",
    "Comparison",
    "KernelFigures",
    "KernelSurvey",
    "MatchedSetting",
    "Peer",
    "PeerFigures",
    "Reference",
    "installed_peers",
    "random_point",
    "random_points",
    "run_bench",
    "solve_reference",
]
