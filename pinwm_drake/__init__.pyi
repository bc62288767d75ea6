# SPDX-License-Identifier: MIT
from .capture.check import check_capture as check_capture
from .capture.scene import load_capture as load_capture
from .control.runner import Runner as Runner
from .experiments.alignment import align as align
from .experiments.evaluation.run import evaluate as evaluate
from .experiments.golden_samples import export_bundle as export_bundle
from .experiments.next_push import next_push as next_push
from .experiments.prediction import predict as predict
from .experiments.requests.evaluate import EvaluateRequest as EvaluateRequest
from .experiments.requests.train import TrainRequest as TrainRequest
from .experiments.training import train as train
from .experiments.twins import identify as identify
from .learning.bundle import read_bundle as read_bundle
from .physics.parameters import Parameters as Parameters
from .physics.state import State as State
from .physics.stepper import Stepper as Stepper
from .rendering.camera import Camera as Camera
from .rendering.render import render as render
from .rendering.surfels import Surfels as Surfels
from .systems.crosscheck.crosscheck import crosscheck as crosscheck
from .systems.envs.registration import ENV_IDS as ENV_IDS
from .systems.runs.session import simulate as simulate
from .systems.station.station import make_station as make_station
from .twin.read import load_twin as load_twin
from .twin.rollout import twin_physics as twin_physics

__version__: str
