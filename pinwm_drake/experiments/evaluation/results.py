# SPDX-License-Identifier: MIT
"""Results of an evaluation: evaluation.json, episodes.csv, and the contents of the report."""

import csv
import json
import math
import os
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from pinwm_drake.capture.pusher import pusher_surface
from pinwm_drake.experiments.evaluation.contestant import Contestant, delays_of, lags_of, station_of
from pinwm_drake.experiments.requests.evaluate import EvaluateRequest
from pinwm_drake.files import replacing
from pinwm_drake.geometry.meshes import load_mesh
from pinwm_drake.learning.evaluation import Evaluation
from pinwm_drake.provenance import timestamp, versions
from pinwm_drake.report.camera import ViewCamera
from pinwm_drake.report.evaluation.episode import EpisodeRecord
from pinwm_drake.report.evaluation.film import EpisodeFilm
from pinwm_drake.report.evaluation.report import EvaluationStory
from pinwm_drake.report.scene import coloured_actors
from pinwm_drake.systems.envs.env import TaskEnv
from pinwm_drake.systems.runs.film import object_actors
from pinwm_drake.systems.scenario.setup import Setup
from pinwm_drake.tasks.registry import recipe_of

_TILE, _SECTIONS = 200, 12  # px of a picture of an episode, and sides of a pusher that is shown that small
_COLUMNS = (
    *("seed", "outcome", "success", "steps", "distance", "angle", "start_x", "start_y", "start_yaw"),
    *("pusher_x", "pusher_y", "start_distance", "start_angle", "failure", "coverage", "goal"),
)


def settings_of(request: EvaluateRequest, contestant: Contestant, env: TaskEnv, scene_sha256: str) -> dict[str, Any]:
    """Return settings that the results depend on, but for the seeds, as plain data."""
    (least, most), lags, acceleration = delays_of(contestant, request), lags_of(contestant), env.worlds.acceleration
    pusher: dict[str, Any] = {"lag": list(lags)} if any(lags) else {}
    pusher |= {"acceleration": acceleration} if math.isfinite(acceleration) else {}
    return {
        "policy": contestant.kind,
        "policy_sha256": contestant.identity,
        "scene": env.setup.scenario.name,
        "scene_sha256": scene_sha256,
        "engine": env.engine,
        **{f"task.{name}": value for name, value in env.task.to_document().items()},
        "start_yaw": [float(value) for value in env.setup.scenario.start.yaw],
        "latency": least if least == most else [least, most],
        **pusher,
        "max_steps": env.max_steps,
        "max_translation": env.run.max_translation,
        "observes": contestant.observes,
        "image": [env.setup.camera.width, env.setup.camera.height] if contestant.observes == "rgb" else None,
        **({} if (station := station_of(request)) is None else {"stand_in": asdict(station)}),
    }


def provenance_of(
    request: EvaluateRequest,
    contestant: Contestant,
    env: TaskEnv,
    records: Sequence[EpisodeRecord],
    workers: int,
) -> dict[str, Any]:
    """Provenance of the results, and the time that they took, as plain data."""
    actions = sum(record.result.steps for record in records)
    return {
        "command": shlex.join(["pinwm", *sys.argv[1:]]),
        "created": timestamp(),
        "policy": request.policy,
        "policy_provenance": contestant.provenance,
        "policy_spec": None if contestant.spec is None else contestant.spec.to_document(),
        "scene": request.scene or env.setup.scenario.name,
        "object": env.setup.twin.name,
        "model": request.model,
        "versions": versions() | {name: version(name) for name in ("drake", "gymnasium")},
        "workers": workers,
        "cores": os.cpu_count(),
        "seconds_per_episode": float(np.mean([record.seconds for record in records])),
        "cpu_seconds_per_episode": float(np.mean([record.cpu_seconds for record in records])),
        "cpu_seconds_per_action": sum(record.cpu_seconds for record in records) / actions,
    }


def write_evaluation(
    path: Path,
    evaluation: Evaluation,
    seeds: Sequence[int],
    settings: Mapping[str, Any],
    provenance: Mapping[str, Any],
) -> None:
    """Write evaluation.json; SI units and radians.

    Raises:
        InputError: It cannot be written.
    """
    document = {
        "schema_version": 1,
        "results": evaluation.summary(),
        "seeds": [seeds[0], seeds[-1]],
        "settings": dict(settings),
        "provenance": dict(provenance),
    }
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(document, indent=2, ensure_ascii=False, default=str) + "\n", encoding="utf-8")


def write_episodes(path: Path, records: Sequence[EpisodeRecord], q_WO: tuple[float, float, float, float]) -> None:
    """Write episodes.csv, a row for each; SI units and radians, world frame.

    Args:
        path: The file.
        records: The episodes.
        q_WO: (4,) wxyz, orientation of the object at yaw 0.

    Raises:
        InputError: It cannot be written.
    """
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(_COLUMNS)
        for record in records:
            one = record.result
            begun = [*record.start(q_WO), *record.p_WP[0, :2].tolist(), one.start_distance, one.start_angle]
            ended = [one.seed, one.outcome, int(one.success), one.steps, one.distance, one.angle]
            goal = " ".join(f"{value:.6g}" for value in record.goal)
            table.writerow([*ended, *begun, one.failure, one.coverage, goal])


def story_of(
    request: EvaluateRequest,
    believed: Setup,
    env: TaskEnv,
    records: Sequence[EpisodeRecord],
    settings: Mapping[str, Any],
    provenance: Mapping[str, Any],
) -> EvaluationStory:
    """Contents of the report; `believed` is the scene without what a stand-in changes."""
    task, setup = env.task, env.setup
    where = f"{setup.twin.name} in {setup.scenario.name}, {env.engine}"
    return EvaluationStory(
        title=f"Evaluation of {request.policy}: {where}",
        about=f"{request.policy}: object {where}; {recipe_of(task).success_words(task)}",
        records=records,
        max_steps=env.max_steps,
        horizon=setup.period,
        q_WO=lying(env),
        settings=settings,
        provenance=provenance,
        film=episode_film(env, visual_path=believed.visual_path if request.stand_in else None),
    )


def lying(env: TaskEnv) -> tuple[float, float, float, float]:
    """Orientation q_WO (4,) wxyz in which the object of a scene lies, before it is turned about z."""
    w, x, y, z = env.setup.scenario.start.q_WO
    return w, x, y, z


def episode_film(env: TaskEnv, height: int = _TILE, visual_path: Path | None = None) -> EpisodeFilm:
    """Draws an environment's episodes as seen from where the scene's camera is.

    Args:
        env: The environment.
        height: Of a picture [px]; it is as wide in proportion as the camera's.
        visual_path: Mesh in colours of the object, frame O; None for that of the scene.
    """
    setup = env.setup
    X_WC, scale = setup.X_WC, height / setup.camera.height
    focal = scale * float(setup.camera.intrinsics[1])
    width = round(scale * setup.camera.width)
    return EpisodeFilm(
        ViewCamera(X_WC.rotation().matrix(), X_WC.translation(), focal, width, height),
        setup.twin.floor_height,
        object_actors(setup) if visual_path is None else coloured_actors(visual_path),
        load_mesh(setup.twin.mesh_path),
        pusher_surface(setup.twin.pusher, sections=_SECTIONS),
        lambda record: env.task.with_goal(record.goal).goal_pose(setup.twin.floor_height),
    )
