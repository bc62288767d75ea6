# SPDX-License-Identifier: MIT
"""What the gallery keeps of an object: figures of its twin as JSON, and a film of a predicted push as GIF."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw
from scipy.spatial import cKDTree

from benchmarks.gallery.captures import PIXELS, VIEWS, Exhibit
from benchmarks.results import machine
from pinwm_drake.capture.episodes import read_episode
from pinwm_drake.capture.ground_truth import GROUND_TRUTH_FILE
from pinwm_drake.capture.scene import load_capture
from pinwm_drake.documents import read_json
from pinwm_drake.files import prepare_folder, replacing
from pinwm_drake.provenance import timestamp
from pinwm_drake.report.captions import font
from pinwm_drake.report.notice import INK
from pinwm_drake.report.surfels.fit_results import ALIGN_FILE
from pinwm_drake.report.twin.comparison_frames import Cast, Shot, draw_shots
from pinwm_drake.report.twin.data import read_ground_truth
from pinwm_drake.report.twin.score import pose_errors
from pinwm_drake.twin.predict import TWO_SIDED, predict_motion
from pinwm_drake.twin.read import load_twin

_PANEL = 300  # px, longer side
_COLOURS, _LARGEST = (192, 128, 96, 64, 48, 32), 400_000  # of a palette; bytes of a film
_LAST = 1500  # ms, that the end stays
_LINE = 22  # px, of the words above the panels


def record(exhibit: Exhibit, work: Path, out: Path, commands: list[str]) -> None:
    """Write NAME.json and NAME.gif: the twin, and its prediction of the push that it was not identified from.

    Args:
        exhibit: The object.
        work: Folder with its capture and twin.
        out: Folder of the results.
        commands: What made capture and twin.
    """
    twin, capture = load_twin(work / "twin"), load_capture(work / "capture")
    first, second = (read_episode(capture, name) for name in capture.episode_names[:2])
    predicted, spread = predict_motion(twin, capture, second, None)
    assert second.object_poses is not None
    errors, fitted = pose_errors(predicted, second.object_poses), read_json(work / "twin" / ALIGN_FILE)
    assert errors is not None
    truth = read_ground_truth(capture.folder / GROUND_TRUTH_FILE)
    moved = second.object_poses.p_WO[-1] - second.object_poses.p_WO[0]
    document: dict[str, Any] = {
        "name": exhibit.name,
        "title": exhibit.title,
        "created": timestamp(),
        "commands": commands,
        "machine": machine(),
        "capture": {
            "engine": "Drake, hydroelastic contact; clean images",
            "pixels": PIXELS,
            "static_views": VIEWS,
            "frames": [len(first.t), len(second.t)],
        },
        "surfels": {"number": twin.surfels.num_surfels, "held_out_dB": fitted["psnr"]["held_out"].value},
        "identification": {name: twin.provenance[name] for name in ("seconds", "loss", "seed")},
        "theta": {
            name: {
                "value": one.value,
                "interval": None if one.interval is None else list(one.interval),
                "identifiable": one.identifiable,
                "unit": one.unit,
                "truth": truth.get(name),
            }
            for name, one in twin.theta.items()
        },
        "prediction": {
            "episode": second.name,
            "object_moved_mm": 1e3 * float(np.hypot(*moved[:2])),
            "position_mm": {"mean": 1e3 * float(errors.position.mean()), "largest": 1e3 * float(errors.position.max())},
            "rotation_deg": _degrees(errors.rotation),
            "told_95_mm": None if spread is None else 1e3 * TWO_SIDED * float(spread.position[-1]),
            "end_mm": 1e3 * float(errors.position[-1]),
        },
    }
    prepare_folder(out)
    with replacing(out / f"{exhibit.name}.json") as temporary:
        temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    shots = draw_shots(second, predicted, Cast.of(twin, None), size=_PANEL, most=len(second.t))
    rate = (len(second.t) - 1) / float(second.t[-1] - second.t[0])
    write_gif(out / f"{exhibit.name}.gif", [_frame(shot) for shot in shots], rate)


def _degrees(angles: np.ndarray) -> dict[str, float]:
    return {"mean": float(np.degrees(angles.mean())), "largest": float(np.degrees(angles.max()))}


def _frame(shot: Shot) -> np.ndarray:
    """Camera and twin side by side, enlarged to the size of a film, each with a line above it."""
    panels = []
    for panel, words in zip(shot.panels, (f"camera, t = {shot.t:.2f} s", "predicted by the twin"), strict=False):
        scale = _PANEL / max(panel.shape[:2])
        size = (round(scale * panel.shape[1]), round(scale * panel.shape[0]))
        picture = Image.new("RGB", (size[0], size[1] + _LINE), "white")
        picture.paste(Image.fromarray(panel).resize(size, Image.Resampling.LANCZOS), (0, _LINE))
        ImageDraw.Draw(picture).text((6, 3), words, font=font(14), fill=INK)
        panels.append(np.asarray(picture))
    return np.concatenate(panels, axis=1)


def write_gif(path: Path, frames: list[np.ndarray], rate: float) -> None:
    """Write pictures (height, width, 3) uint8 as a film that repeats, in as many colours as 400 kB allow."""
    # White is the background; the other colours of a palette are those of the rest.
    pixels = np.concatenate([frame.reshape(-1, 3) for frame in frames])
    coloured = pixels[pixels.min(axis=1) < 250]
    sheet = Image.fromarray(coloured[: len(coloured) // 64 * 64].reshape(-1, 64, 3))
    times = [round(1000 / rate)] * (len(frames) - 1) + [_LAST]
    for colours in _COLOURS:
        found = sheet.quantize(colours - 1, method=Image.Quantize.MEDIANCUT, kmeans=2).getpalette() or []
        palette = np.concatenate(([[255, 255, 255]], np.reshape(found, (-1, 3)))).astype(np.uint8)
        nearest = cKDTree(palette)
        shown = []
        for frame in frames:
            shown.append(Image.fromarray(nearest.query(frame)[1].astype(np.uint8)))
            shown[-1].putpalette(palette.tobytes())
        with replacing(path) as temporary:
            shown[0].save(temporary, save_all=True, append_images=shown[1:], duration=times, loop=0, optimize=True)
        if path.stat().st_size <= _LARGEST:
            return
    raise SystemExit(f"{path}: got {path.stat().st_size} bytes; allowed: {_LARGEST}; make the film smaller")
