"""From an engine to its controller: maps, optimal motions, charge model, estimator, law."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from plant import CrankAnglePlant, Engine, MeanValuePlant, ParameterError
from plant.sensors import SensorSet

from .charge_model import ChargeModel
from .command_limits import CommandLimits
from .controller import AirChargeController
from .controller_parts import Adaptation
from .fault_monitor import FaultMonitor
from .fault_reaction import FaultReaction
from .kalman_adaptation import KalmanAdaptation
from .kalman_estimator import KalmanEstimator
from .least_loss_motion import FeedforwardOptions
from .optimal_path import OptimalPath

Progress = Callable[[str, int, int], None]

_SPEED_MARGINS = (0.8, 1.15)  # speeds that are believed, over the model's lowest and highest


@dataclass(frozen=True)
class ControllerDesign:
    """Controller of an engine, and what it was made from.

    Attributes
    ----------
    engine : Engine
        Nominal engine.
    maps : MeanValuePlant
        Maps of its full plant, runner and actuator oscillation on.
    path : OptimalPath
        Motions of least pumping loss.
    model : ChargeModel
        Charge along the path, with the parameters of a cylinder.
    controller : AirChargeController
        The controller.
    """

    engine: Engine
    maps: MeanValuePlant = field(repr=False)
    path: OptimalPath = field(repr=False)
    model: ChargeModel = field(repr=False)
    controller: AirChargeController = field(repr=False)

    def __str__(self) -> str:
        """Return what it was made from, and the law."""
        law = type(self.controller.adaptation).__name__
        return f"{self.path}\n{self.model}\nlaw: {law}"

    def with_law(self, adaptation: Adaptation, *, adapt: bool = True) -> AirChargeController:
        """Return the controller with another adaptation law."""
        return self.controller.replace(adaptation=adaptation, adapt=adapt)

    def feedforward_alone(self) -> AirChargeController:
        """Return the controller that learns nothing and sees no density."""
        return self.controller.replace(adapt=False, density_gain=0.0)


def design_controller(
    engine: Engine | None = None,
    *,
    maps: MeanValuePlant | None = None,
    path: OptimalPath | None = None,
    model: ChargeModel | None = None,
    options: FeedforwardOptions | None = None,
    sensors: SensorSet | None = None,
    adaptation: Adaptation | None = None,
    progress: Progress | None = None,
) -> ControllerDesign:
    """Make the air-charge controller of an engine.

    Parameters
    ----------
    engine : Engine, optional
        The engine as it is known; the paper's by default. Its cylinders are equal.
    maps : MeanValuePlant, optional
        Maps of its full plant with runner and actuator oscillation; fitted if not given.
    path : OptimalPath, optional
        Path of optimal motions on those maps; found if not given.
    model : ChargeModel, optional
        Charge model of that path; fitted if not given.
    options : FeedforwardOptions, optional
        Of the feedforward.
    sensors : SensorSet, optional
        Sensors that the estimator assumes; the default ones if not given.
    adaptation : Adaptation, optional
        Law; `path_adaptation` by default.
    progress : callable, optional
        Called with what is being made, the number of parts done and the number in all.

    Raises
    ------
    ParameterError
        For an engine with unequal cylinders, or maps of another plant.
    """
    base = Engine.paper() if engine is None else engine
    if len(set(base.cylinder_flow_factors)) > 1:
        raise ParameterError(
            f"cylinder_flow_factors are {base.cylinder_flow_factors}, but the controller starts "
            "from equal cylinders and learns the rest: leave them out"
        )
    plant = CrankAnglePlant(base, runner=True, oscillation=True)
    if path is not None:
        maps, options = path.maps, path.options
    if maps is None:
        maps = MeanValuePlant.fit(plant, progress=_of("maps", progress))
    options = FeedforwardOptions() if options is None else options
    if path is None:
        path = OptimalPath.fit(maps, options=options, progress=_of("optimal motions", progress))
    if model is None:
        longest = options.longest_deg(base, maps.region)
        model = ChargeModel.fit(
            path,
            plant,
            lowest_lift_mm=options.lowest_lift_mm,
            longest_deg=longest,
            progress=_of("charge model", progress),
        )
    if model.plant_fingerprint != plant.fingerprint:
        raise ParameterError(
            f"the charge model is one of the full plant {model.plant_fingerprint}, but the "
            f"engine's is {plant.fingerprint}: fit it to CrankAnglePlant(engine, runner=True, "
            "oscillation=True)"
        )
    sensors = SensorSet() if sensors is None else sensors
    controller = AirChargeController(
        model,
        KalmanEstimator.of(base, maf=sensors.maf, map=sensors.map),
        path_adaptation() if adaptation is None else adaptation,
        n_cylinders=base.n_cylinders,
        limits=CommandLimits(
            lift_mm=(options.lowest_lift_mm, options.highest_lift_mm),
            longest_duration_deg=model.longest_deg,
            valvetrain=base.valvetrain,
        ),
        duration_noise=sensors.duration.noise,
        ambient_pressure=base.ambient_pressure,
        faults=FaultReaction(FaultMonitor.of(base, sensors)),
        speed_range_rpm=(
            _SPEED_MARGINS[0] * float(model.speeds_rpm[0]),
            _SPEED_MARGINS[1] * float(model.speeds_rpm[-1]),
        ),
    )
    return ControllerDesign(base, maps, path, model, controller)


def path_adaptation() -> KalmanAdaptation:
    """Return the least-squares law with the walks that suit motions of least pumping loss.

    With the valve wide open the charge hardly depends on the flow gain (0.04 of its change at 750
    rpm, 0.1 at 1500, 0.6 at 6000 rpm), so that a gain that walks faster costs little noise of
    charge, and what all cylinders share is left to the charge factor. Differences of gains and
    offsets are remembered for some ten cycles.
    """
    return KalmanAdaptation(
        common_flow_walk=1e-3,
        flow_walk=4e-3,
        common_offset_walk=2.5e-6,
        offset_walk=8e-6,
        charge_walk=5e-4,
    )


def _of(name: str, progress: Progress | None) -> Callable[[int, int], None] | None:
    """Return a progress call that tells what it is about."""
    if progress is None:
        return None
    tell = progress
    return lambda done, total: tell(name, done, total)
