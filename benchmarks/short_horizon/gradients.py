"""The gradient through the step: what it costs, whether it is right, and how much it varies over horizons."""

import math
import time

import numpy as np
import torch
from torch import Tensor

from benchmarks import timing
from benchmarks.short_horizon.learner import Learner, LearnerOptions
from benchmarks.short_horizon.networks import teacher_spec
from benchmarks.short_horizon.worlds import PushWorlds
from pinwm_drake.systems.envs.training_worlds import TrainingWorlds

WORLDS = 64
HORIZONS = (1, 2, 4, 8, 16)
WIDTHS = (1e-3, 1e-4, 1e-5)  # of an action
AGREES, RIGHT = 3e-3, 1e-2
_LEAST = 1e-6
_SPEED, _APART = 0.5, 0.1  # of the longest translation in an action


def heading(state: Tensor) -> Tensor:
    """Actions (W, 2) of the pusher towards the object's origin."""
    c, s, x, y = state[:, 2], state[:, 3], -state[:, 7], -state[:, 8]
    ahead = torch.stack([c * x - s * y, s * x + c * y], 1)
    return ahead / ahead.norm(dim=1, keepdim=True).clamp(min=0.1)


def in_touch(worlds: PushWorlds, before: int = 6) -> None:
    """Brings the pushers to the objects, where most touch."""
    with torch.no_grad():
        for _ in range(before):
            worlds.advance(0.5 * heading(worlds.seen()))


def cost(training: TrainingWorlds, rounds: int) -> dict[str, timing.Samples]:
    """CPU seconds an action of 64 worlds: the environment, and ours without gradient, with it, and back."""
    env, worlds = training.worlds("state"), PushWorlds(training, WORLDS, 0)
    env.seed(0)
    seen = {"env": env.reset()}
    horizon, kept = 8, {}

    def environment() -> None:
        for _ in range(horizon):
            seen["env"] = env.step(0.5 * heading(torch.from_numpy(seen["env"])).numpy())[0]

    def plain() -> None:
        with torch.no_grad():
            _play(worlds, horizon)

    def forward() -> None:
        action = torch.zeros(WORLDS, 2, requires_grad=True)
        kept["loss"] = _play(worlds, horizon, action)

    def backward() -> None:
        kept["loss"].backward()

    cases = {
        "environment": timing.Case(environment, units=horizon),
        "ours, no gradient": timing.Case(plain, units=horizon),
        "ours, for a gradient": timing.Case(forward, units=horizon),
        "ours, back": timing.Case(backward, units=horizon),
    }
    return timing.interleave(cases, rounds, warmup=2, clock=time.process_time)


def _play(worlds: PushWorlds, horizon: int, extra: Tensor | float = 0.0) -> Tensor:
    """Sum of the rewards of actions towards the object, episodes beginning anew at their ends."""
    worlds.cut()
    total = torch.zeros(())
    for _ in range(horizon):
        out = worlds.advance(0.5 * heading(worlds.seen()) + extra)
        total = total + worlds.task.rewards(out.before, out.after, bonus=False).sum()
        worlds.begin(out.ended)
    return total


def _return(worlds: PushWorlds, actions: Tensor) -> Tensor:
    """Sum (W,) of the rewards of actions (h, W, 2), without the bonus."""
    worlds.cut()
    total = torch.zeros(worlds.num_worlds, dtype=torch.float64)
    for action in actions:
        out = worlds.advance(action)
        total = total + worlds.task.rewards(out.before, out.after, bonus=False)
    return total


def against_differences(training: TrainingWorlds, horizon: int, seed: int = 0) -> dict[str, float]:
    """Derivatives of the return by the first action, against central differences of three widths.

    Where the differences do not agree among themselves to within 0.3 %, a contact changes between them.

    Returns:
        Numbers of worlds whose derivative is right to within 1 %, wrong, or at a kink.
    """
    worlds = PushWorlds(training, WORLDS, seed)
    in_touch(worlds)
    object_state, p_WP = worlds.object_state.numpy(), worlds.p_WP.numpy()
    g = torch.Generator().manual_seed(seed)
    actions = 0.4 * heading(worlds.seen())[None].double() + 0.1 * torch.randn(horizon, WORLDS, 2, generator=g).double()
    direction = torch.nn.functional.normalize(torch.randn(WORLDS, 2, generator=g).double(), dim=1)

    def value(s: Tensor) -> Tensor:
        worlds.place(object_state, p_WP)
        return _return(worlds, torch.cat([(actions[0] + s[:, None] * direction)[None], actions[1:]]))

    s = torch.zeros(WORLDS, dtype=torch.float64, requires_grad=True)
    (analytic,) = torch.autograd.grad(value(s).sum(), s)
    ones = torch.ones(WORLDS, dtype=torch.float64)
    with torch.no_grad():
        found = torch.stack([(value(w * ones) - value(-w * ones)) / (2.0 * w) for w in WIDTHS]).numpy()
    counts = {"right": 0, "wrong": 0, "kink": 0}
    for world, exact in enumerate(analytic.numpy()):
        d = found[:, world]
        apart = np.abs(np.diff(d)) / np.maximum(np.maximum(np.abs(d[1:]), np.abs(d[:-1])), _LEAST)
        best = int(np.argmin(apart))
        if apart[best] > AGREES:
            counts["kink"] += 1
        else:
            error = abs(exact - d[best + 1]) / max(abs(d[best + 1]), _LEAST)
            counts["right" if error < RIGHT else "wrong"] += 1
    return counts | {"finite": int(torch.isfinite(analytic).sum())}


def slope(training: TrainingWorlds, horizon: int, noise: float, repeats: int, seed: int = 1) -> dict[str, float]:
    """Slope of the mean return by the speed at which pushers head for the object, from the scene's starts.

    All repeats begin in the same 64 states, each with a noise of its own. The difference quotients take the same noise
    on both sides, and know of contacts that come about or do not.

    Returns:
        Mean and standard error of the derivative through the step, "step" and "step, error", and of the difference
        quotients, "differences" and "differences, error".
    """
    worlds = PushWorlds(training, WORLDS, seed)
    object_state, p_WP = worlds.object_state.numpy(), worlds.p_WP.numpy()

    def mean_return(speed: Tensor, number: int) -> Tensor:
        g = torch.Generator().manual_seed(number)
        worlds.place(object_state, p_WP)
        total = torch.zeros(WORLDS, dtype=torch.float64)
        for _ in range(horizon):
            out = worlds.advance(speed * heading(worlds.seen()) + noise * torch.randn(WORLDS, 2, generator=g))
            total = total + worlds.task.rewards(out.before, out.after, bonus=False)
        return total.mean()

    found: dict[str, list[float]] = {"step": [], "differences": []}
    for number in range(repeats):
        speed = torch.tensor(_SPEED, requires_grad=True)
        found["step"].append(float(torch.autograd.grad(mean_return(speed, number), speed)[0]))
        with torch.no_grad():
            up, down = (float(mean_return(torch.tensor(_SPEED + d), number)) for d in (_APART, -_APART))
        found["differences"].append((up - down) / (2.0 * _APART))
    means = {name: float(np.mean(rows)) for name, rows in found.items()}
    errors = {f"{name}, error": float(np.std(rows, ddof=1) / math.sqrt(repeats)) for name, rows in found.items()}
    return means | errors


def signal(learner: Learner, horizon: int, batches: int = 12) -> dict[str, float]:
    """Signal over noise of the actor's gradient from one rollout: through the step, and by likelihood ratios.

    All rollouts begin in the same states. With gradients g_k of n rollouts, m their mean and s^2 the mean of
    |g_k - m|^2: the square of the true gradient's length is |m|^2 - s^2 / n, without bias, and what is given back its
    ratio to s^2, so that 1 over it is the number of rollouts for a gradient as long as its error.
    """
    worlds = learner.worlds
    object_state, p_WP = worlds.object_state.detach().numpy(), worlds.p_WP.detach().numpy()
    weights = [one for name, one in learner.actor.named_parameters() if name != "log_std"]
    found: dict[str, list[Tensor]] = {"through": [], "likelihood": []}
    for _ in range(batches):
        worlds.place(object_state, p_WP)
        rollout = learner.rollout(horizon)
        for name, rows in found.items():
            bars = torch.autograd.grad(getattr(rollout, name), weights, retain_graph=name == "through")
            rows.append(torch.cat([bar.flatten() for bar in bars]))
    result = {}
    for name, rows in found.items():
        g = torch.stack(rows).double()
        mean = g.mean(0)
        noise = float((g - mean).square().sum(1).sum()) / (len(g) - 1)
        result[name] = (float(mean.square().sum()) - noise / len(g)) / noise
        result[f"{name}, length"] = float(mean.norm())
    first, second = (torch.stack(rows).double().mean(0) for rows in found.values())
    result["cosine"] = float(torch.nn.functional.cosine_similarity(first, second, dim=0))
    return result


def fresh(training: TrainingWorlds, options: LearnerOptions, seed: int) -> Learner:
    """A learner whose critic alone has learned, with pushers that touch the objects."""
    torch.manual_seed(seed)
    learner = Learner(PushWorlds(training, WORLDS, seed), teacher_spec(training), options)
    in_touch(learner.worlds)
    return learner
