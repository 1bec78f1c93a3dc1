"""A rollout as a function that PyTorch differentiates.

    import torch, powderline as pl
    from powderline.torch import loss

    simulator = pl.Simulator(pl.Scene.load("bench-small"))
    theta = torch.zeros(5, requires_grad=True)
    loss(simulator, theta).backward()
    theta.grad                                      # of shape (5,), metres
    with torch.no_grad():                           # a step of 0.1, whatever the slope, within the range
        theta -= 0.1 * theta.grad / theta.grad.norm()
        theta.clamp_(-1.0, 1.0)
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from ._native import Simulator

_KINDS = ("restarted", "differences", "adjoint")


class SkillLoss(torch.autograd.Function):
    """The loss of skills, metres; `loss` is the same as a function."""

    @staticmethod
    def forward(ctx: Any, theta: torch.Tensor, simulator: Simulator, kind: str, needs_gradient: bool) -> torch.Tensor:
        """theta: shape (5,) or (n, 5). Gradients are computed here, where they will be needed: the rollout is the same."""
        rows = theta.detach().to("cpu", torch.float64).numpy().reshape(-1, 5)
        if needs_gradient:
            found = [simulator.gradient(row, kind=kind) for row in rows]  # type: ignore[arg-type]
            losses = [evaluation.loss for evaluation, _ in found]
            gradients = np.array([gradient for _, gradient in found]).reshape(theta.shape)
            ctx.save_for_backward(torch.from_numpy(gradients).to(theta))
        else:
            losses = [evaluation.loss for evaluation in simulator.rollouts(rows)]
        return torch.tensor(losses, dtype=theta.dtype, device=theta.device).reshape(theta.shape[:-1])

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *grad_outputs: torch.Tensor) -> tuple[torch.Tensor, None, None, None]:
        """Of the losses' shape."""
        (gradient,) = ctx.saved_tensors
        return grad_outputs[0].unsqueeze(-1) * gradient, None, None, None


def loss(simulator: Simulator, theta: torch.Tensor, *, kind: str = "restarted") -> torch.Tensor:
    """Loss of a skill, or of each of several, metres.

    Args:
        simulator: of the scene.
        theta: depth, scooping angle, lift, transport, pouring angle, each from -1 to 1; shape (5,) or (n, 5).
        kind: of the gradient, see `Simulator.gradient`.

    Returns:
        A tensor of shape () or (n,).

    Raises:
        TypeError: theta is not of floating-point numbers.
        ValueError: it has another shape, or there is no such kind.
        SkillError: it is beyond -1 or 1.
        MotionError: powder leaves the simulated volume; another theta may come to an end.
    """
    if kind not in _KINDS:
        raise ValueError(f"kind is {kind!r}, but it must be one of {', '.join(_KINDS)}")
    if not theta.is_floating_point():
        raise TypeError(f"theta is of {theta.dtype}, but it must be of floating-point numbers, such as torch.float64")
    if theta.dim() not in (1, 2) or theta.shape[-1] != 5:
        raise ValueError(f"theta has shape {tuple(theta.shape)}, but it must be (5,) or (n, 5)")
    # What the function itself is told says nothing of `torch.no_grad()`.
    needs_gradient = torch.is_grad_enabled() and theta.requires_grad
    return SkillLoss.apply(theta, simulator, kind, needs_gradient)  # type: ignore[no-any-return]
