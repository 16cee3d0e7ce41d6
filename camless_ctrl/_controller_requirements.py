"""Requirements on the controller against the full plant, faults and scenarios included."""

from __future__ import annotations

from ._requirement import PROJECT, Requirement

CONTROLLER: tuple[Requirement, ...] = (
    Requirement(
        "feedforward-loss",
        1.0,
        "%",
        "at most",
        PROJECT,
        "pumping loss of the optimal path on the full plant above the best of a direct search "
        "at the same charge, at 50 random demands and speeds",
    ),
    Requirement(
        "estimate-cylinder",
        1.0,
        "%",
        "at most",
        PROJECT,
        "largest mean error of a cylinder's estimated charge against the full plant, 750 to "
        "6000 rpm and 3, 4, 6 cylinders, one of them 15 % weak; gain error of the sensor apart",
    ),
    Requirement(
        "estimate-honest",
        1.1,
        "1",
        "at most",
        PROJECT,
        "spread of the estimation error over the standard deviation that the filter tells",
    ),
    Requirement(
        "estimate-innovation",
        0.25,
        "1",
        "at most",
        PROJECT,
        "distance of the mean normalised innovation on the full plant from 1",
    ),
    Requirement(
        "controller-bars",
        0.0,
        "1",
        "at most",
        PROJECT,
        "figures of the performance table that the adaptive controller misses in a seed; "
        "those of single events count where the valves do not jitter",
    ),
    Requirement(
        "cylinder-error",
        1.0,
        "%",
        "at most",
        PROJECT,
        "largest charge error of a cylinder in the load step with one weak cylinder at 1500 "
        "rpm, averaged from 10 cycles after each step on and over the seeds",
    ),
    Requirement(
        "imbalance",
        0.5,
        "%",
        "at most",
        PROJECT,
        "(max - min)/mean of the cylinders' charges in the load step with one weak cylinder at "
        "1500 rpm, averaged from 10 cycles after each step on and over the seeds",
    ),
    Requirement(
        "command-lift-lowest",
        0.5,
        "mm",
        "at least",
        PROJECT,
        "lowest lift commanded in the load step",
    ),
    Requirement(
        "command-lift-highest",
        8.0,
        "mm",
        "at most",
        PROJECT,
        "highest lift commanded in the load step",
    ),
    Requirement(
        "faults-missed",
        0.0,
        "faults",
        "at most",
        PROJECT,
        "kinds of faults at 1500 rpm that raise no alarm and are not harmless: the mean charge of "
        "a cylinder stays more than 2 % off",
    ),
    Requirement(
        "fault-detection",
        60.0,
        "events",
        "at most",
        PROJECT,
        "longest time from the start of a fault of a sensor or of the speed signal at 1500 rpm to "
        "its alarm",
    ),
    Requirement(
        "fault-charge-error",
        15.0,
        "%",
        "at most",
        PROJECT,
        "largest charge error of a single event, jitter of the valve included, while one sensor or "
        "the speed signal is at fault at 1500 rpm",
    ),
    Requirement(
        "fault-recovery",
        1.0,
        "%",
        "at most",
        PROJECT,
        "largest mean charge error of a cylinder in the last 20 of 60 cycles after a fault",
    ),
    Requirement(
        "false-alarms",
        0.0,
        "events",
        "at most",
        PROJECT,
        "events with an alarm in 10,000 fault-free cycles of sampled engines, sensors and "
        "operations",
    ),
    Requirement(
        "scenario-requirements",
        0.0,
        "1",
        "at most",
        PROJECT,
        "requirements of the scenario library that are not met; those of single events under "
        "jitter count in the like scenario without jitter",
    ),
)
