"""A short-horizon actor-critic: the gradient of a few actions' rewards and of the value after them, through the step.

Source: Xu et al., "Accelerated policy learning with parallel differentiable simulation" (ICLR 2022), SHAC. Betas of
Adam, lambda, learning rate, `clip` and `slow` are those of `examples/cfg/shac/ant.yaml` in NVlabs/DiffRL; the horizon
is half of its, gamma and the width of networks are SAC's here. The mixture with the gradient of zeroth order: Suh et
al., "Do differentiable simulators give better policy gradients?" (ICML 2022).
"""

import copy
import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from benchmarks.short_horizon.networks import GaussianActor, make_critic
from benchmarks.short_horizon.worlds import PushWorlds
from pinwm_drake.errors import SolverError, require
from pinwm_drake.learning.option_checks import check_options
from pinwm_drake.learning.spec import PolicySpec

_BATCH = 256  # states in an update of the critic


@dataclass(frozen=True)
class LearnerOptions:
    """Settings of the learner.

    Attributes:
        horizon: Number of actions that the gradient goes through.
        gamma: Discount of an action; that of SAC here.
        lam: Weight of the longer returns in the critic's targets.
        share: Share of the gradient through the step, 0 to 1; the rest is of zeroth order (likelihood ratios).
        arrival: Flag: the critic learns the bonus as the value of a success, so that it has a slope on the way there;
            without it the bonus is a reward, which has none.
        learning_rate: Learning rate of Adam at first, of actor and critic; it falls evenly to a tenth.
        clip: Largest norm of the actor's gradient.
        noise: Standard deviation of the actions, before the tanh, at first; it is learned.
        entropy: Weight of the entropy of an action.
        passes: Number of passes of the critic over the states of a rollout.
        critic_first: Number of rollouts of the untrained actor that the critic learns from beforehand.
        slow: Share of its old weights that the slow critic keeps in an update.

    Raises:
        ParameterError: A number is out of range.
    """

    horizon: int = 16
    gamma: float = 0.95
    lam: float = 0.95
    share: float = 1.0
    arrival: bool = False
    learning_rate: float = 2e-3
    clip: float = 1.0
    noise: float = 0.37
    entropy: float = 0.0
    passes: int = 8
    critic_first: int = 0
    slow: float = 0.2

    def __post_init__(self) -> None:
        """Checks the values."""
        check_options(self, ("lam", "share", "arrival", "entropy", "critic_first", "slow"))
        for name in ("gamma", "lam", "share", "slow"):
            require(name, getattr(self, name), getattr(self, name) <= 1.0, "1 at most")


@dataclass(frozen=True, eq=False)
class Rollout:
    """Outcome of a horizon in W worlds.

    Attributes:
        through: () mean reward of an action, the value after the last included, with the gradient through the step.
        likelihood: () number with the same gradient in expectation, of zeroth order.
        seen: (n, 11) states for the critic.
        targets: (n,) their values by TD(lambda).
    """

    through: Tensor
    likelihood: Tensor
    seen: Tensor
    targets: Tensor


class Learner:
    """Actor and critic, with what they learn in.

    Attributes:
        worlds: The worlds that they learn in.
        actor: The actor.
        critic: The critic.
        steps: Number of actions so far, all worlds together.
        skipped: Number of updates that were left out, as the gradient was not finite or the adjoint had no solution.
    """

    def __init__(self, worlds: PushWorlds, spec: PolicySpec, options: LearnerOptions) -> None:
        """Makes networks; torch's generator has been seeded by the caller."""
        self.actor, self.critic = GaussianActor(spec, math.log(options.noise)), make_critic(spec)
        self.worlds, self._options = worlds, options
        self._slow = copy.deepcopy(self.critic).requires_grad_(False)
        self._adam = [
            torch.optim.Adam(one.parameters(), options.learning_rate, betas=(0.7, 0.95))
            for one in (self.actor, self.critic)
        ]
        self.steps = self.skipped = 0
        for _ in range(options.critic_first):
            with torch.no_grad():
                found = self.rollout()
            self._learn_critic(found)

    def update(self, left: float) -> dict[str, float]:
        """One update of actor and critic.

        Args:
            left: Share of the training that is left, 1 at first.

        Returns:
            Norm of the actor's gradient before it is cut, mean reward with the value, loss of the critic.
        """
        options = self._options
        for adam in self._adam:
            adam.param_groups[0]["lr"] = options.learning_rate * (0.1 + 0.9 * left)
        found = self.rollout()
        wanted = options.share * found.through + (1.0 - options.share) * found.likelihood
        loss = -wanted - options.entropy * self.actor.log_std.sum()
        self._adam[0].zero_grad()
        norm = torch.tensor(torch.nan)
        try:
            loss.backward()
            norm = nn.utils.clip_grad_norm_(self.actor.parameters(), options.clip)
        except SolverError:
            pass  # an adjoint without a solution; the norm stays NaN
        if bool(norm.isfinite()):
            self._adam[0].step()
            with torch.no_grad():
                self.actor.log_std.clamp_(-2.0, 0.5)
        else:
            self.skipped += 1
        critic = self._learn_critic(found)
        return {"norm": float(norm), "value": float(found.through.detach()), "critic": critic}

    def rollout(self, horizon: int | None = None) -> Rollout:
        """A horizon in all worlds, from where they are; worlds whose episode ends begin anew within it."""
        worlds, options = self.worlds, self._options
        h, W, gamma = horizon or options.horizon, worlds.num_worlds, options.gamma
        bonus = worlds.task.task.bonus
        worlds.cut()
        seen = worlds.seen()
        total, discount = torch.zeros(W), torch.ones(W)
        rows: list[tuple[Tensor, ...]] = []
        arrivals, log_p = [], []
        for t in range(h):
            mean, std = self.actor.means(seen), self.actor.log_std.exp()
            raw = mean + std * torch.randn_like(mean)
            # Of the action in a state that is as it is: no gradient goes through that state.
            here = self.actor.means(seen.detach())
            log_p.append(-(0.5 * ((raw.detach() - here) / std).square() + self.actor.log_std).sum(1))
            # Without the gradient through the step, nothing is kept for it.
            action = self.actor.heading.action(raw.tanh(), seen)
            out = worlds.advance(action if options.share else action.detach())
            reward = worlds.task.rewards(out.before, out.after, bonus=not options.arrival).float()
            success, last = out.after.success, out.ended if t < h - 1 else torch.ones(W, dtype=torch.bool)
            value = self._slow(out.seen)[:, 0]
            known = value.detach()
            if options.arrival:
                known = torch.where(success, torch.full_like(known, bonus / gamma), known)
                arrivals.append(out.seen.detach()[success])
            else:
                value, known = value * ~success, known * ~success
            total = total + discount * (reward + torch.where(last, gamma * value, torch.zeros(W)))
            discount = torch.where(out.ended, torch.ones(W), gamma * discount)
            rows.append((seen.detach(), reward.detach(), known, out.ended))
            worlds.begin(out.ended)
            seen = worlds.seen()
        self.steps += h * W
        came, rewards, values, ends = (torch.stack(column) for column in zip(*rows, strict=True))
        targets, states = td_lambda(rewards, values, ends, gamma, options.lam), came.flatten(0, 1)
        with torch.no_grad():
            advantage = targets.flatten() - self._slow(states)[:, 0]
        likelihood = (advantage * torch.cat(log_p)).mean()
        reached = torch.cat(arrivals) if arrivals else states[:0]
        values = torch.cat([targets.flatten(), torch.full((len(reached),), bonus / gamma)])
        return Rollout(total.mean() / h, likelihood, torch.cat([states, reached]), values)

    def _learn_critic(self, found: Rollout) -> float:
        """Teaches the critic the targets; gives its last loss."""
        loss = torch.tensor(0.0)
        for _ in range(self._options.passes):
            for rows in torch.randperm(len(found.seen)).split(_BATCH):
                loss = nn.functional.mse_loss(self.critic(found.seen[rows])[:, 0], found.targets[rows])
                self._adam[1].zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(self.critic.parameters(), self._options.clip)
                self._adam[1].step()
        keep = self._options.slow
        with torch.no_grad():
            for slow, fast in zip(self._slow.parameters(), self.critic.parameters(), strict=True):
                slow.lerp_(fast, 1.0 - keep)
        return float(loss.detach())


def td_lambda(rewards: Tensor, values: Tensor, ended: Tensor, gamma: float, lam: float) -> Tensor:
    """Values (h, W) of the states before h actions by TD(lambda), cut at the ends of episodes and of the horizon.

    Args:
        rewards: (h, W) rewards of the actions.
        values: (h, W) values of the states after them, before any world begins anew.
        ended: (h, W) bool, true where an episode ended with the action.
        gamma: Discount of an action.
        lam: Weight of the longer returns, 0 to 1.
    """
    found, longer = [], values[-1]
    for reward, value, end in zip(rewards.flip(0), values.flip(0), ended.flip(0), strict=True):
        longer = reward + gamma * torch.where(end, value, (1.0 - lam) * value + lam * longer)
        found.append(longer)
    return torch.stack(found[::-1])
