"""Differentiable rigid-body physics: parameters, model, state, contact, stepper."""

from pinwm_drake.physics.diagnose import StepReport, inspect
from pinwm_drake.physics.model import Body, Joint, Model
from pinwm_drake.physics.parameters import Parameters
from pinwm_drake.physics.state import State, Trajectory
from pinwm_drake.physics.stepper import Stepper

__all__ = ["Body", "Joint", "Model", "Parameters", "State", "StepReport", "Stepper", "Trajectory", "inspect"]
