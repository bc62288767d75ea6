# SPDX-License-Identifier: MIT
"""Pages of the gallery: a table of all objects, and a page for each, from the stored results."""

import json
from pathlib import Path
from typing import Any

from benchmarks.gallery.captures import EXHIBITS
from benchmarks.results import markdown
from pinwm_drake.report.page import error_words, interval_words
from pinwm_drake.twin.twin import Estimate

_WORDS = {
    "mass": "mass",
    "inertia_xx": "moment of inertia about x",
    "inertia_yy": "moment of inertia about y",
    "inertia_zz": "moment of inertia about z",
    "friction_floor": "friction, object and floor",
    "friction_pusher": "friction, object and pusher",
    "restitution_floor": "restitution, floor",
    "restitution_pusher": "restitution, pusher",
}


def write_pages(folder: Path) -> None:
    """Write FOLDER.md, the table, and FOLDER/NAME.md for each object that has results in the folder."""
    found = [json.loads(path.read_text(encoding="utf-8")) for path in _paths(folder)]
    for one in found:
        (folder / f"{one['name']}.md").write_text(_object_page(one), encoding="utf-8")
    folder.with_suffix(".md").write_text(_table_page(folder.name, found), encoding="utf-8")


def _paths(folder: Path) -> list[Path]:
    return [path for path in (folder / f"{exhibit.name}.json" for exhibit in EXHIBITS) if path.exists()]


def _estimate(entry: dict[str, Any]) -> Estimate:
    interval = entry["interval"]
    return Estimate(entry["value"], None if interval is None else tuple(interval), entry["identifiable"], entry["unit"])


def _table_page(folder: str, found: list[dict[str, Any]]) -> str:
    rows = []
    for one in found:
        friction, prediction = one["theta"]["friction_floor"], one["prediction"]
        value, interval = interval_words(_estimate(friction))
        rows.append(
            (
                f"[{one['title']}]({folder}/{one['name']}.md)",
                f"![{one['title']}: camera and prediction]({folder}/{one['name']}.gif)",
                value,
                interval,
                f"{friction['truth']:.4g}",
                f"{prediction['position_mm']['mean']:.1f}",
                f"{prediction['rotation_deg']['mean']:.1f}",
                f"{prediction['object_moved_mm']:.0f}",
            )
        )
    seconds = [one["identification"]["seconds"] for one in found]
    took = f"{min(seconds):.0f} to {max(seconds):.0f}"
    header = (
        "object | film of the prediction | floor friction | 95 % interval | true | position error [mm] | "
        "rotation error [°] | the object moved [mm]"
    )
    return f"""# Gallery

This page is for readers who want to see twins of several objects. After it they can make the same for an own object.

Each twin is identified from the first push of a capture. The film shows the second push, which the twin never saw.
On the left is the camera, on the right the twin's prediction from the pusher's log. Errors are means over the film.

{chr(10).join(markdown(header, rows))}

The captures are simulated in Drake with hydroelastic contact; their images are clean. The pusher is drawn where its log
has it, since captures leave it out. One push of each object is an example and no statistics.

`python -m benchmarks.gallery` makes everything on this page and goes on where it was stopped. Captures, twins and their
reports stay in `out/gallery/`. Identification took {took} s an object, on one thread beside other work.
"""


def _object_page(one: dict[str, Any]) -> str:
    rows = []
    for name, entry in one["theta"].items():
        estimate = _estimate(entry)
        value, interval = interval_words(estimate)
        truth, error = error_words(estimate, entry["truth"])
        unit = "" if entry["unit"] == "1" else f" [{entry['unit']}]"
        tells = "yes" if entry["identifiable"] else "no"
        rows.append((f"{_WORDS[name]}{unit}", value, interval, truth, error, tells))
    prediction, capture, search = one["prediction"], one["capture"], one["identification"]
    told = prediction["told_95_mm"]
    figures = [
        ("images of a push", f"{capture['frames'][0]}, {capture['pixels']} px wide"),
        ("static views", str(capture["static_views"])),
        ("surfels", f"{one['surfels']['number']:,}"),
        ("held-out views, mean PSNR", f"{one['surfels']['held_out_dB']:.1f} dB"),
        ("identification, one thread beside other work", f"{search['seconds']:.0f} s"),
        ("the object moved in the predicted push", f"{prediction['object_moved_mm']:.0f} mm"),
        ("position error of the prediction, mean", f"{prediction['position_mm']['mean']:.2f} mm"),
        ("position error of the prediction, largest", f"{prediction['position_mm']['largest']:.2f} mm"),
        ("rotation error of the prediction, mean", f"{prediction['rotation_deg']['mean']:.2f}°"),
        ("rotation error of the prediction, largest", f"{prediction['rotation_deg']['largest']:.2f}°"),
        ("position error at the end", f"{prediction['end_mm']:.2f} mm"),
        ("95 % of ends lie within, as the twin tells", "–" if told is None else f"{told:.1f} mm"),
    ]
    commands, machine = "\n".join(one["commands"]), one["machine"]
    return f"""# {one["title"]}

![{one["title"]}: on the left the camera, on the right the twin's prediction]({one["name"]}.gif)

The film shows a push that the twin was not identified from. The pusher is drawn where its log has it.

## The twin

{chr(10).join(markdown("parameter | value | 95 % interval | true | error | the video tells it", rows))}

## Figures

{chr(10).join(markdown("figure | value", figures))}

## Commands

<!-- snippet: long -->
```bash
{commands}
```

Made at {one["created"]} from commit {machine["commit"]} on {machine["processor"]}.
[Back to the gallery](../gallery.md)
"""
