# SPDX-License-Identifier: MIT
"""Adds surfels where the image asks for more, and takes those away that hardly show.

Source: Kerbl et al. (2023), section 5.2, with two changes. How many are added is a share of those there are, taken in
order of their screen gradients, so that the number never passes its limit. And a split is along the longer tangent and
not at random; a clone leaves the joint opacity as it was (Rota Bulò et al., "Revising Densification in Gaussian
Splatting", 2024, section 4.3).
"""

import torch

from pinwm_drake.rendering.fit_options import FitOptions
from pinwm_drake.rendering.fit_state import SURFEL, FitState
from pinwm_drake.spatial.rotations import quaternion_to_matrix

# A surfel is split from this scale on, in px of a typical view; smaller ones are cloned.
_SPLIT = 2.0
# Halves of a split: how much shorter they are, and how far from the middle, in units of the old scale.
_SHORTER, _APART = 0.6, 0.7
_MOST_OPACITY = 0.995


@torch.no_grad()
def densify(state: FitState, options: FitOptions, pixel: float) -> tuple[int, int]:
    """Prunes and grows the surfels of a fit; `pixel` is the size of a pixel on the object, m.

    Returns:
        How many were added and taken away.
    """
    tensors = {name: state.tensors[name].detach() for name in SURFEL}
    N = state.num_surfels
    keep = tensors["logit_opacity"].sigmoid() >= options.least_opacity
    if not bool(keep.any()):
        keep[tensors["logit_opacity"].argmax()] = True
    kept = int(keep.sum())
    room = max(min(options.max_surfels - kept, int(options.growth * N)), 0)
    wanted = torch.where(keep, state.screen / state.counts.clamp_min(1.0), 0.0)
    parents = torch.sort(wanted, descending=True, stable=True).indices[:room]
    parents = parents[wanted[parents] > 0.0]
    scale, axis = tensors["log_scale"].max(1)
    split = scale[parents] > torch.tensor(_SPLIT * pixel).log()

    children = {name: value[parents].clone() for name, value in tensors.items()}
    rows = torch.arange(len(parents))
    R_OS = quaternion_to_matrix(torch.nn.functional.normalize(children["q_OS"], dim=-1))
    tangent = R_OS[rows, :, axis[parents]]
    offset = (split * _APART * scale[parents].exp())[:, None] * tangent
    children["log_scale"][rows, axis[parents]] += torch.where(split, torch.tensor(_SHORTER).log(), 0.0)
    opacity = children["logit_opacity"].sigmoid()
    shared = 1.0 - (1.0 - opacity).sqrt()
    children["logit_opacity"] = torch.where(split, opacity, shared).clamp_max(_MOST_OPACITY).logit()
    keep[parents] = False
    halves = [{**children, "p_OS": children["p_OS"] + sign * offset} for sign in (1.0, -1.0)]
    state.replace(keep, {name: torch.cat([half[name] for half in halves]) for name in SURFEL})
    return len(parents), N - kept
