"""Dynamics of rods: inertia, damping, varying tendons, contacts and a moving base."""

from glissando.simulation.dynamics.base_motion import BaseMotion
from glissando.simulation.dynamics.integrate import simulate_motion
from glissando.simulation.dynamics.motion import DynamicMotion, Energies, MovingSection
from glissando.simulation.dynamics.scenario import HalfSpace, Hold, Scenario, TimedWrench

__all__ = [
    "BaseMotion",
    "DynamicMotion",
    "Energies",
    "HalfSpace",
    "Hold",
    "MovingSection",
    "Scenario",
    "TimedWrench",
    "simulate_motion",
]
