"""A rollout as a function that PyTorch differentiates.

    import torch, powderline as pl
    from powderline.torch import loss

    simulator = pl.Simulator(pl.Scene.load("bench-small"))
    theta = torch.zeros(5, requires_grad=True)
    loss(simulator, theta).backward()
    theta.grad                                      # of shape (5,), metres
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from ._native import Simulator


class SkillLoss(torch.autograd.Function):
    """The loss of skills, metres; `loss` is the same as a function."""

    @staticmethod
    def forward(ctx: Any, theta: torch.Tensor, simulator: Simulator, kind: str) -> torch.Tensor:
        """theta: shape (5,) or (n, 5). Gradients are computed here, where they will be needed: the rollout is the same."""
        rows = theta.detach().to("cpu", torch.float64).numpy().reshape(-1, 5)
        if ctx.needs_input_grad[0]:
            found = [simulator.gradient(row, kind=kind) for row in rows]  # type: ignore[arg-type]
            losses = [evaluation.loss for evaluation, _ in found]
            gradients = np.array([gradient for _, gradient in found]).reshape(theta.shape)
            ctx.save_for_backward(torch.from_numpy(gradients).to(theta))
        else:
            losses = [evaluation.loss for evaluation in simulator.rollouts(rows)]
        return torch.tensor(losses, dtype=theta.dtype, device=theta.device).reshape(theta.shape[:-1])

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, *grad_outputs: torch.Tensor) -> tuple[torch.Tensor, None, None]:
        """Of the losses' shape."""
        (gradient,) = ctx.saved_tensors
        return grad_outputs[0].unsqueeze(-1) * gradient, None, None


def loss(simulator: Simulator, theta: torch.Tensor, *, kind: str = "restarted") -> torch.Tensor:
    """Loss of a skill, or of each of several, metres.

    Args:
        simulator: of the scene.
        theta: depth, scooping angle, lift, transport, pouring angle, each from -1 to 1; shape (5,) or (n, 5).
        kind: of the gradient, see `Simulator.gradient`.

    Returns:
        A tensor of shape () or (n,).
    """
    return SkillLoss.apply(theta, simulator, kind)  # type: ignore[no-any-return]
