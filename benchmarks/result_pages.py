# SPDX-License-Identifier: MIT
"""Tables of README.md and docs/results that are written from stored results.

    python -m benchmarks.result_pages

Each table stands between markers with its name. The sources are the JSON files in docs/results and the cells in
docs/results/reproduce. The tables in docs/results/tables.md are those of `pinwm reproduce report`.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from benchmarks import calibration as calibration_benchmark
from benchmarks import flip_frontier
from benchmarks.next_push.coverage import coverage_table
from benchmarks.next_push.evaluate import cells
from benchmarks.next_push.pokes import table_lines
from benchmarks.real import tables
from benchmarks.results import markdown, with_block
from pinwm_drake.geometry.pieces import touching_pieces
from pinwm_drake.geometry.primitive import acting_pieces, acting_words
from pinwm_drake.geometry.stored_pieces import mesh_pieces, mesh_primitives
from pinwm_drake.models import OBJECT_NAMES, object_model
from pinwm_drake.paper.reproduce import paper

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "docs/results"
Rows = Iterable[Iterable[object]]


def read(name: str) -> Any:
    """Stored result by its file's name in docs/results."""
    return json.loads((RESULTS / name).read_text(encoding="utf-8"))


def cell(key: str) -> Any:
    """Result of a cell of `pinwm reproduce`."""
    return read(f"reproduce/{key}/done.json")["result"]


def percent(share: float) -> str:
    """Share in percent with three digits, e.g. "94.6 %"."""
    return f"{100.0 * share:.3g} %"


def interval(low: float, high: float) -> str:
    """Interval of a share, e.g. "94.6 to 99.8 %"."""
    return f"{100.0 * low:.3g} to {100.0 * high:.3g} %"


_TRAINED = (
    ("cousins of the twin, seed 0", "pin-wm", 0),
    ("cousins of the twin, seed 1", "pin-wm", 1),
    ("the twin alone", "pin-wm-0", 0),
    ("the true θ", "true-theta", 0),
)
_SECOND = "mug, true theta, as it is"  # the other training with the true theta, in flip.json


def headline() -> str:
    """Table of success and friction beside the paper's, one figure a cell."""
    rows: list[tuple[str, str, str, str]] = []
    for task, words in (("push", "push"), ("flip", "flip of a mug")):
        for trained, system, seed in _TRAINED:
            known = paper.POLICIES[task, system].split(",")[0]
            results = [cell(f"evaluations/{task}/{system}/seed-{seed}")]
            if (task, system) == ("flip", "true-theta"):
                results = [read("flip.json")[_SECOND]["results"], *results]
            for number, one in enumerate(results, 1):
                which = f", training {number}" if len(results) > 1 else ""
                here = percent(one["success_rate"])
                rows.append((f"{words}; {trained}{which}", known, here, interval(*one["interval_95"])))
    for task, words, true in (("push", "push", "0.03"), ("flip", "poke of a mug", "0.2")):
        found = cell(f"twins/pin-wm-friction_floor/{task}/seed-0")["estimates"]["friction_floor"]
        low, high = found["interval"]
        known = paper.PARAMETERS[task, "pin-wm", "friction_floor"]
        here = f"{found['value']:.3g}"
        rows.append((f"floor friction from a {words} (true: {true})", known, here, f"{low:.3g} to {high:.3g}"))
    return table("simulation | paper | here | 95 % interval", rows)


def acts_as() -> str:
    """Table of what each shipped object acts as, and of the convex pieces that are left."""
    rows = []
    for name in OBJECT_NAMES:
        path = object_model(name).mesh_path
        found, pieces = mesh_primitives(path), mesh_pieces(path)
        met = len(touching_pieces(acting_pieces(pieces, found)))
        rows.append((name, acting_words(found), f"{len(pieces)}", f"{met}"))
    return table("object | acts as | pieces of the mesh | pieces that are met from outside", rows)


def meshes() -> str:
    """Table of twins with a wrong mesh: errors of one action, friction of the floor and loss."""
    rows = []
    for task, true in (("push", "0.03"), ("flip", "0.2")):
        for noise in ("", "-noise-0.005", "-noise-0.01", "-noise-0.03"):
            for refined in ("", "-refined") if noise and task == "push" else ("",):
                twin = cell(f"twins/pin-wm/{task}{noise}{refined}/seed-0")
                step = cell(f"one-step/pin-wm/{task}{noise}{refined}/seed-0")
                friction = twin["estimates"]["friction_floor"]
                mesh = f"{100.0 * float(noise.removeprefix('-noise-')):g} %" if noise else "true"
                rows.append(
                    (
                        task,
                        mesh + (", fitted to the masks" if refined else ""),
                        f"{1e3 * step['translation']['mean']:.3g} mm",
                        f"{step['rotation']['mean']:.3g} rad",
                        f"{friction['value']:.3g} ({true})",
                        f"{friction['interval'][0]:.3g} to {friction['interval'][1]:.3g}",
                        "yes" if friction["identifiable"] else "no",
                        f"{twin['loss']:.2g}",
                    )
                )
    return table(
        "task | mesh | translation | rotation | friction (true) | 95 % interval | identifiable | loss",
        rows,
    )


def review() -> str:
    """Table of success in a reviewer's MuJoCo, with Wilson's intervals of the counts that the shares stand for."""
    rows = []
    for row in read("robustness_review.json")["rows"]:
        count = round(row["success_rate"] * row["episodes"])
        rows.append((row["task"], row["condition"], percent(row["success_rate"]), *_counted(count, row["episodes"])))
    return table("task | condition | success | 95 % interval (Wilson) | episodes", rows)


def elsewhere(file: str = "flip_elsewhere.json") -> str:
    """Table of policies of flips in engines, or by simulated arms, without part in their training."""
    words, rows = {engine: name for name, engine in _ENGINES.items()} | _ARMS, []
    for row in read(file)["results"]:
        floor, pusher = row.get("friction_floor", 0.2), row.get("friction_pusher", 0.9)
        late, success = f"{1e3 * row['latency']:.0f} ms", percent(row["successes"] / row["episodes"])
        told = success, *_counted(row["successes"], row["episodes"]), f"{row['actions']:.1f}"
        rows.append((row["policy"], words[row["engine"]], floor, pusher, late, *told))
    header = "policy | engine | floor | pusher | delay | success | 95 % interval (Wilson) | episodes | actions"
    return table(header, rows)


def faults() -> str:
    """Table of the faults of a rehearsal, and of the time until the robot stands."""
    rows = [
        (
            name,
            f"{fault['good']} of {fault['trials']}",
            *(f"{fault[key]:.3f} s" for key in ("median_to_zero", "longest_to_zero")),
            f"{fault['allowed']:.2f} s",
        )
        for name, fault in read("rehearsal_faults.json")["summary"]["faults"].items()
    ]
    return table("fault | stopped in time | median | longest | allowed", rows)


_PUSHES = (  # words, command, training seed, key in push.json
    ("SAC teacher and student, two cores", "`pinwm train TWIN`", 0, "default, waves of 30 rad, one command"),
    ("PPO from images", "`--method ppo`", 0, "PPO from images, 107 minutes"),
    ("PPO from images", "`--method ppo`", 1, "PPO from images, seed 1, 73 minutes"),
    ("PPO from images", "`--method ppo`", 2, "PPO from images, seed 2, 69 minutes"),
    (
        "goals within ±10 cm, any yaw",
        "`--goals random --yaw 3.14159 --steps 1200000`",
        0,
        "goals random, waves of 30 rad, images that do not smear",
    ),
    ("same", "same", 1, "goals random, seed 1"),
    ("same", "same", 2, "goals random, seed 2"),
    (
        "starts at any yaw",
        "`--yaw 3.14159 --steps 1200000`",
        0,
        "start yaw pi, waves of 30 rad, images that do not smear",
    ),
    ("same", "same", 1, "start yaw pi, seed 1"),
    ("same", "same", 2, "start yaw pi, seed 2"),
    (
        "goal within 10 mm and 0.1 rad",
        "`--tolerance 0.01 --turn-tolerance 0.1`",
        0,
        "10 mm and 0.1 rad, images that do not smear",
    ),
    ("same", "same", 1, "10 mm and 0.1 rad, seed 1"),
    ("same", "same", 2, "10 mm and 0.1 rad, seed 2"),
)
_FLIPS = (  # words, training seed, key in flip.json
    ("mug, twin of two pokes", 0, "mug, seed 0"),
    ("mug, twin of two pokes", 1, "mug, seed 1"),
    ("mug, twin of two pokes", 2, "mug, seed 2"),
    ("mug, twin of one poke", 0, "mug, twin of one poke"),
    ("mug, twin of one poke, no cousins (`--delta 0`)", 0, "mug, twin of one poke, without cousins"),
    ("mug, true θ", 0, "mug, true theta, as it is"),
    ("mug with a handle, twin of one poke", 0, "handle, twin of one poke"),
    ("cube, twin of one poke, cousins of ±10 %", 0, "cube, twin of one poke, as it is"),
    ("cube, twin of one poke, `--from-intervals`", 0, "cube, twin of one poke, from intervals"),
    ("cube, twin of two pokes", 0, "cube, window, twin of two pokes"),
)


def _counted(successes: int, episodes: int) -> tuple[str, int]:
    """Wilson's interval of a share of successes, and the number of episodes."""
    return interval(*binomtest(successes, episodes).proportion_ci(method="wilson")), episodes


def _success(result: Mapping[str, Any]) -> tuple[str, str, str]:
    """Success, interval and mean number of actions of an evaluation."""
    actions = f"{result['steps']['all']['mean']:.1f}"
    return percent(result["success_rate"]), interval(*result["interval_95"]), actions


_MEASURED = "success | 95 % interval (Wilson) | actions"


def pushes() -> str:
    """Table of policies of pushes, from push.json."""
    stored = read("push.json")
    rows = [(words, command, seed, *_success(stored[key]["results"])) for words, command, seed, key in _PUSHES]
    return table(f"training | command | seed | {_MEASURED}", rows)


def flips() -> str:
    """Table of policies of flips in both of Drake's contacts, from flip.json."""
    stored, rows = read("flip.json"), list[tuple[object, ...]]()
    for words, seed, key in _FLIPS:
        for engine in ("hydroelastic", "point"):
            found = stored.get(f"{key}, {engine}") or (stored[key] if engine == "hydroelastic" else None)
            if found is not None:
                rows.append((words, seed, engine, *_success(found["results"])))
    return table(f"trained for | seed | contact | {_MEASURED}", rows)


_PREDICTED = "captures | predictions | median | nine of ten | worst | 95 % intervals of the last pose hold"
_ENGINES = {
    "MuJoCo": "mujoco",
    "Bullet": "bullet",
    "Drake, hydroelastic": "hydroelastic",
    "Drake, points": "point",
}
_ARMS = {"panda": "Panda over LCM, hydroelastic"}


def _predictions(kind: str, method: str, pushes: int, engine: str = "") -> list[dict[str, Any]]:
    """Stored results of captures of a kind (clean, realistic), by a method from so many pushes, of an engine or all."""
    (group,) = (one["results"] for one in read("next_push.json")["groups"] if one["kind"] == kind)
    return [
        one
        for one in group
        if one["method"] == method and len(one["pushes"]) == pushes and one["capture"].endswith(engine)
    ]


def _from_pushes(pushes: int) -> list[tuple[str, list[dict[str, Any]]]]:
    """Rows of twins from so many pushes: words and results."""
    whole = _predictions("clean", "ours", pushes)
    engines = [(f"of these {words}", _predictions("clean", "ours", pushes, key)) for words, key in _ENGINES.items()]
    return [("clean captures", whole), *engines]


def _predicted(heading: str, rows: Iterable[tuple[str, list[dict[str, Any]]]]) -> str:
    """Table of predictions, one row for each group of results."""
    cells_of_rows = ((words, len({one["capture"] for one in found}), *cells(found)) for words, found in rows)
    return table(f"{heading} | {_PREDICTED}", cells_of_rows)


def one_push() -> str:
    """Table of predictions by twins from one push."""
    rows = _from_pushes(1)
    unseen = [one for one in rows[0][1] if one["split"] == "unseen"]
    rows.append(("of these captures that nothing was chosen on", unseen))
    rows.append(("realistic captures", _predictions("realistic", "ours", 1)))
    return _predicted("twin from one push", rows)


def two_pushes() -> str:
    """Table of predictions by twins from two pushes."""
    rows = _from_pushes(2)
    rows.append(("without Bullet", [one for one in rows[0][1] if not one["capture"].endswith("bullet")]))
    return _predicted("twin from two pushes", rows)


def compared() -> str:
    """Table of predictions by other means than twins of this package."""
    even = "true θ in our step, even pressure"
    rows = (
        ("PIN-WM's way, one push", _predictions("clean", "pin-wm", 1)),
        (even, _predictions("clean", "truth", 0)),
        *((f"of these {words}", _predictions("clean", "truth", 0, _ENGINES[words])) for words in ("MuJoCo", "Bullet")),
        ("true θ, realistic captures", _predictions("realistic", "truth", 0)),
        ("object stands still", _predictions("clean", "still", 0)),
    )
    return _predicted("for comparison", rows)


def held() -> str:
    """Table of how often intervals hold the true frictions."""
    rows = []
    for words, kind, pushes in (
        ("one push, clean captures", "clean", 1),
        ("two pushes, clean captures", "clean", 2),
        ("one push, realistic captures", "realistic", 1),
    ):
        row = [words]
        for name in ("friction_floor", "friction_pusher"):
            pairs = [(one["theta"][name][1], one["truth"][name]) for one in _predictions(kind, "ours", pushes)]
            row.append(f"{sum(low <= true <= high for (low, high), true in pairs)} of {len(pairs)}")
        rows.append(row)
    return table("intervals that hold the true friction | floor | pusher", rows)


def _ranks(engine: str = "") -> list[dict[str, Any]]:
    """Ranks of the truth among the draws of each capture of an engine, or of all, as `coverage_table` takes them."""
    return [{"ranks": one} for one in read("coverage.json")["ranks"] if one["capture"].endswith(engine)]


def coverage() -> str:
    """Table of how often central intervals hold the truth."""
    return "\n".join(coverage_table(_ranks()))


def coverage_engines() -> str:
    """Table of the same for 95 %, by engine."""
    rows = []
    for words, key in _ENGINES.items():
        lines = [line.strip("| ").split(" | ") for line in coverage_table(_ranks(key))[2:]]
        rows.append((words, len(_ranks(key)), *(line[-1] for line in lines)))
    return table("within 95 % | captures | friction of the floor | friction of the pusher | place | yaw", rows)


def late_camera() -> str:
    """Table of a rehearsal with a camera that is late."""
    found = read("rehearsal_normal.json")["summary"]["normal"]
    number, good = found["episodes"], found["successes"]
    share = percent(good / number), _counted(good, number)[0]
    row = (number, f"{found['minutes']:.1f} min", found["false_stops"], good, *share)
    return table("episodes | acting | false stops | at the goal at the end | share | 95 % interval (Wilson)", [row])


_STOPPED = {
    "twin": "twin",
    "point": "point",
    "hydroelastic": "hydroelastic",
    "arm": "lcm within the process (`--simulate-arm`)",
    "lcm": "lcm, an arm in another process",
}


def stopping() -> str:
    """Table of signals at random moments, by engine."""
    rows = []
    for key, found in read("stopping.json")["engines"].items():
        counts = found["counts"]
        before = sum(count for when, count in counts.items() if "before" in when)
        armed = sum(count for when, count in counts.items() if "while armed" in when)
        closed, good = counts["hangup, at any moment"], found["moments"] - counts["bad"]
        rows.append((_STOPPED[key], found["moments"], before, armed, closed, good))
    return table("engine | runs | before it was armed | while armed | terminal closed | good", rows)


def station_push() -> str:
    """Table of a push policy for a calibrated station."""
    found = read("station_push.json")
    results, delay = found["results"], f"{1e3 * found['settings']['latency']:.0f} ms"
    return table(f"episodes | delay of actions | {_MEASURED}", [(results["episodes"], delay, *_success(results))])


def frontier() -> str:
    """Table of where a stroke flips an object."""
    return flip_frontier.table(read("flip_frontier.json")["results"])


def stand_in() -> str:
    """Table of the stand-in for a robot."""
    rows = []
    for task in ("push", "flip"):
        found = cell(f"stand-in/{task}/pin-wm/seed-0")
        rows.append((task, *_success(found), f"{found['steps']['successes']['mean']:.1f}"))
    return table("task | success | 95 % interval (Wilson) | actions | actions where it succeeds", rows)


def calibration() -> str:
    """Table of calibrations of rendered labs."""
    return calibration_benchmark.table(
        {name: case["seeds"] for name, case in read("calibration.json")["cases"].items()}
    )


def clock() -> str:
    """Table of the clocks of films that chose nothing."""
    return table("what | 20 films, seeds 100 to 119", read("clock.json")["summary"].items())


def mit() -> str:
    """Table of MIT's real pushes."""
    return tables.mit(read("real.json")["cases"])


def triangle() -> str:
    """Table of CMU's real triangle."""
    return tables.triangle(read("real.json")["cases"])


def others() -> str:
    """Table of the real steel plate and of tosses."""
    return tables.others(read("real.json")["cases"])


def table(header: str, rows: Rows) -> str:
    """Table in Markdown."""
    return "\n".join(markdown(header, rows))


def pokes() -> str:
    """Table of frictions by one poke each."""
    return "\n".join(table_lines(read("pokes.json")["rows"]))


BLOCKS: tuple[tuple[Path, str, Callable[[], str]], ...] = (
    (ROOT / "README.md", "headline", headline),
    (RESULTS / "index.md", "headline", headline),
    (RESULTS / "limitations.md", "meshes", meshes),
    (ROOT / "docs/explanation/physics.md", "acts_as", acts_as),
    (RESULTS / "policies.md", "pushes", pushes),
    (RESULTS / "policies.md", "flips", flips),
    (RESULTS / "policies.md", "station_push", station_push),
    (RESULTS / "policies.md", "frontier", frontier),
    (RESULTS / "identification.md", "one_push", one_push),
    (RESULTS / "identification.md", "two_pushes", two_pushes),
    (RESULTS / "identification.md", "compared", compared),
    (RESULTS / "identification.md", "held", held),
    (RESULTS / "identification.md", "coverage", coverage),
    (RESULTS / "identification.md", "coverage_engines", coverage_engines),
    (RESULTS / "identification.md", "pokes", pokes),
    (RESULTS / "calibration.md", "calibration", calibration),
    (RESULTS / "clock.md", "clock", clock),
    (RESULTS / "real.md", "mit", mit),
    (RESULTS / "real.md", "triangle", triangle),
    (RESULTS / "real.md", "others", others),
    (RESULTS / "robustness.md", "review", review),
    (RESULTS / "robustness.md", "elsewhere", elsewhere),
    (RESULTS / "robustness.md", "new_objects", partial(elsewhere, "new_objects.json")),
    (RESULTS / "robustness.md", "late_camera", late_camera),
    (RESULTS / "robustness.md", "arms", partial(elsewhere, "arm_flips.json")),
    (RESULTS / "robustness.md", "stand_in", stand_in),
    (RESULTS / "robustness.md", "stopping", stopping),
    (RESULTS / "robustness.md", "faults", faults),
)
"""Pages, with the names of their tables and what makes these."""


def main() -> None:
    """Write all tables into their pages."""
    for page, name, make in BLOCKS:
        page.write_text(with_block(page.read_text(encoding="utf-8"), name, make()), encoding="utf-8")


if __name__ == "__main__":
    main()
