# SPDX-License-Identifier: MIT
"""Timings of the renderer, Drake's VTK renderer and the torch reference, and the growth of the renderer's cost.

All on one core, but for the rows that say otherwise: each setting runs in a process of its own, bound to its cores.
VTK draws the mesh of the same T-block under the same camera, and is timed as `QueryObject.RenderColorImage`, from
pose to uint8 image; ours from torch tensors to torch tensors.
"""

import argparse
import tempfile
from pathlib import Path

from benchmarks import memory, results, timing

PLOT = Path(__file__).resolve().parent / "render.png"
_SURFELS = (500, 1000, 2000, 5000, 10_000, 20_000, 50_000)
_SIZES = (64, 128, 200, 400, 800)
_COUSINS = 32
_MEMORY = {
    "vtk_800": "VTK 800 x 800",
    "forward_800": "kernels 800 x 800, color and alpha",
    "full_gradient_800": "all five, forward and backward",
    "cousins": f"{_COUSINS} cousins in {_COUSINS} poses at 64 x 64",
    "numba_400": "kernels 400 x 400, 2,000 surfels, all five",
    "torch_400": "torch reference of the same",
}
# Largest ratio to VTK, and smallest to the torch reference.
BARS = {"forward_800": 1.3, "gradient_800": 4.0, "forward_64": 0.5, "reference": 50.0}


def _added(name: str) -> float:
    """Memory [MB] that a call adds to this process's at its peak, after a small one of its kind; Linux only."""
    timing.limit_threads(1)
    from benchmarks.scenes import render_scene as scene
    from pinwm_drake.rendering.render import render
    from pinwm_drake.rendering.surfels import Surfels
    from pinwm_drake.spatial.poses import Pose

    X_CO = Pose(*(part[0] for part in scene.poses(1)))
    size = 64 if name == "cousins" else int(name.rsplit("_", 1)[1])
    if name.startswith("vtk"):
        with tempfile.TemporaryDirectory() as folder:
            vtk = scene.Vtk(Path(folder))
        small, run = vtk.renderer(16, X_CO), vtk.renderer(size, X_CO)
    else:
        views = _COUSINS if name == "cousins" else None
        surfels = scene.surfels(5000 if size == 800 else 2000, views)
        X_CO = scene.poses(_COUSINS) if views else X_CO
        tensors = {key: value.requires_grad_("gradient" in name) for key, value in surfels.tensors().items()}
        full, backend = name not in ("forward_800", "cousins"), "torch" if name.startswith("torch") else "numba"

        def run(size: int = size) -> None:
            rendering = render(Surfels(**tensors), scene.camera(size), X_CO, full=full, backend=backend)
            if "gradient" in name:
                (rendering.color.sum() + rendering.depth.sum() + rendering.distortion.sum()).backward()

        def small() -> None:
            run(16)

    small()
    return memory.added(run)[1]


def _measure(cores: int, rounds: int) -> dict:
    timing.limit_threads(cores)
    import torch

    from benchmarks.scenes import render_scene as scene
    from pinwm_drake.rendering.camera import Camera
    from pinwm_drake.rendering.render import render
    from pinwm_drake.rendering.surfels import Surfels
    from pinwm_drake.spatial.poses import Pose

    torch.set_num_threads(cores)
    X_CO = Pose(*(part[0] for part in scene.poses(1)))
    with tempfile.TemporaryDirectory() as folder:
        vtk = scene.Vtk(Path(folder))

    def forward(number: int, size: int, full: bool = False, backend: str = "numba") -> timing.Case:
        surfels, camera = scene.surfels(number), scene.camera(size)
        return timing.Case(lambda: render(surfels, camera, X_CO, full=full, backend=backend))

    def gradient(number: int, size: int, full: bool) -> timing.Case:
        camera = scene.camera(size)
        tensors = {name: value.requires_grad_() for name, value in scene.surfels(number).tensors().items()}
        pose = Pose(X_CO.q.clone().requires_grad_(), X_CO.p.clone().requires_grad_())
        ones = torch.ones(1, size, size, 3)

        def run() -> None:
            rendering = render(Surfels(**tensors), camera, pose, full=full)
            if full:
                images = [rendering.color, rendering.depth, rendering.normal, rendering.distortion]
                torch.autograd.backward(images, [ones, ones[..., 0], ones, ones[..., 0]])
            else:
                rendering.color.backward(ones)

        return timing.Case(run)

    big = {
        "vtk_800": timing.Case(vtk.renderer(800, X_CO)),
        "forward_800": forward(5000, 800),
        "full_800": forward(5000, 800, full=True),
        "gradient_800": gradient(5000, 800, full=False),
        "full_gradient_800": gradient(5000, 800, full=True),
    }
    small = {
        "vtk_64": timing.Case(vtk.renderer(64, X_CO)),
        "forward_64": forward(2000, 64),
        "full_64": forward(2000, 64, full=True),
        "gradient_64": gradient(2000, 64, full=False),
    }
    with timing.CompetingLoad() as load:
        samples = {**timing.interleave(big, rounds), **timing.interleave(small, 20 * rounds)}
    data: dict = {
        "load": load.percent,
        "milliseconds": {name: sample.summary(1e3) for name, sample in samples.items()},
        "over_vtk": {},
    }
    for name, sample in samples.items():
        if not name.startswith("vtk"):
            data["over_vtk"][name] = sample.over(samples["vtk_" + name.rsplit("_", 1)[1]])
    if cores > 1:
        return data

    cases = {"numba": forward(2000, 400, full=True), "torch": forward(2000, 400, full=True, backend="torch")}
    reference = timing.interleave(cases, rounds=3, warmup=1)
    data["reference"] = {name: sample.summary(1e3) for name, sample in reference.items()}
    data["reference"]["speedup"] = reference["torch"].over(reference["numba"])

    many = {}
    for name, views in (("alone", 1), ("together", _COUSINS)):
        surfels, poses, camera = scene.surfels(2000, _COUSINS), scene.poses(_COUSINS), scene.camera(64)

        def run(surfels: Surfels = surfels, poses: Pose = poses, views: int = views, camera: Camera = camera) -> None:
            for first in range(0, _COUSINS, views):
                part = slice(first, first + views)
                own = Surfels(**surfels.tensors() | {"sh": surfels.sh[part]})
                render(own, camera, Pose(poses.q[part], poses.p[part]), full=False)

        many[name] = timing.Case(run, units=_COUSINS)
    data["cousins"] = {name: s.summary(1e6) for name, s in timing.interleave(many, 2 * rounds).items()}

    growth = {}
    for number in _SURFELS:
        growth["surfels", number, "forward"] = forward(number, 400)
        growth["surfels", number, "gradient"] = gradient(number, 400, full=False)
    for size in _SIZES:
        growth["pixels", size, "forward"] = forward(5000, size)
        growth["pixels", size, "gradient"] = gradient(5000, size, full=False)
    data["growth"] = [
        {"axis": axis, "value": value, "kind": kind, "ms": sample.median * 1e3}
        for (axis, value, kind), sample in timing.interleave(growth, rounds).items()
    ]
    return data


def plot(data: dict) -> None:
    """Write render.png: cost against surfels and against pixels."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10.0, 4.2), layout="constrained")
    titles = {"surfels": "surfels, at 400 x 400 px", "pixels": "px along a side, 5,000 surfels"}
    for ax, (axis, title), ticks in zip(axes, titles.items(), (_SURFELS, _SIZES), strict=True):
        for kind, label in (("forward", "forward"), ("gradient", "forward and backward")):
            rows = [row for row in data["growth"] if row["axis"] == axis and row["kind"] == kind]
            ax.loglog([row["value"] for row in rows], [row["ms"] for row in rows], "o-", label=label)
        ax.set(xlabel=title, ylabel="ms an image, one core")
        ax.set_xticks(ticks, [f"{tick:,}" for tick in ticks])
        ax.minorticks_off()
        ax.grid(alpha=0.3)
        ax.legend()
    figure.savefig(PLOT, dpi=130)


def table(data: dict) -> str:
    """Table of the figures, in Markdown."""
    labels = {
        "vtk": "Drake's RenderEngineVtk, the mesh",
        "forward": "color and alpha",
        "full": "color, alpha, depth, normal, distortion",
        "gradient": "color, forward and backward to surfels and pose",
        "full_gradient": "all five, forward and backward",
    }
    one, two, rows = data["one"], data["two"], []
    for name in one["milliseconds"]:
        kind, size = name.rsplit("_", 1)
        cells = []
        for part in (one, two):
            ratio = part["over_vtk"].get(name)
            cells += [results.spread(part["milliseconds"][name], 2), f"{ratio['median']:.2f}" if ratio else "1"]
        number = "" if kind == "vtk" else ("5,000" if size == "800" else "2,000")
        rows.append([f"{size} x {size}", number, labels[kind], *cells])
    reference, cousins, memory = one["reference"], one["cousins"], data["memory"]

    def verdict(part: dict, name: str) -> str:
        return results.verdict(part["over_vtk"][name]["median"], BARS[name])

    lines = [
        *results.markdown("image | surfels | what | one core, ms | / VTK | two cores, ms | / VTK", rows),
        "",
        f"- 800 x 800 forward / VTK: one core {verdict(one, 'forward_800')}; two cores {verdict(two, 'forward_800')}.",
        f"- 800 x 800 forward and backward / VTK: one core {verdict(one, 'gradient_800')}; two cores "
        f"{verdict(two, 'gradient_800')}.",
        f"- 64 x 64 forward / VTK, one core: {verdict(one, 'forward_64')}.",
        f"- 400 x 400, 2,000 surfels, all five images, torch reference / kernels on one core: "
        f"{results.verdict(reference['speedup']['median'], BARS['reference'], at_most=False)} "
        f"({reference['torch']['median']:.0f} ms against {reference['numba']['median']:.1f} ms).",
        f"- {_COUSINS} cousins (own harmonics each) in {_COUSINS} poses, 64 x 64, 2,000 surfels: "
        f"{cousins['together']['median']:.0f} µs an image in one call, {cousins['alone']['median']:.0f} µs one by one.",
        "- Added to the resident memory at the peak, MB, each in a process of its own: "
        + "; ".join(f"{label} {memory[name]:.0f}" for name, label in _MEMORY.items())
        + ".",
        "",
        f"{data['rounds']} rounds, at 64 x 64 20 times as many; other processes took {one['load']:.0f} % of the CPUs "
        f"beside one core and {two['load']:.0f} % beside two.",
    ]
    return "\n".join(lines)


def measure(given: argparse.Namespace) -> dict:
    """Measures times on one core and on two, and memory, each in a process of its own."""
    one, two = (timing.alone(_measure, cores, given.rounds) for cores in (1, 2))
    return {"one": one, "two": two, "memory": {name: timing.alone(_added, name) for name in _MEMORY}}


if __name__ == "__main__":
    results.run("render", __doc__ or "", measure, table, rounds=15, plot=lambda data: plot(data["one"]))
