"""What a fine-tuning adds to the decoder of curves: layers of actors, the base's emotions."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from deitalk.emotions import EMOTIONS


class BaseChange(nn.Module):
    """What an emotion that captures do not show adds to their curves (not in the paper).

    It is the change of the model before its fine-tuning, from the captured emotions to the wanted
    one on the same speech, carried to the rig by a matrix.

    Parameters
    ----------
    captured : sequence of bool
        Emotions that captures show; at least one. Weights of the others go to the reference, which
        is the first of them: neutral, where it is captured.
    n_controls, n_base : int
        Controls of the rig, and of the model before.
    """

    is_captured: Tensor

    def __init__(self, captured: Sequence[bool], n_controls: int, n_base: int) -> None:
        super().__init__()
        self.reference = list(captured).index(True)
        self.register_buffer("is_captured", torch.tensor(list(captured)), persistent=False)
        self.carry = nn.Parameter(torch.zeros(n_controls, n_base), requires_grad=False)
        """Share of each control of the model before in each of the rig."""
        self.pose = nn.Parameter(torch.zeros(len(captured), n_controls), requires_grad=False)
        """What each emotion adds besides: the part of its change that does not move with speech,
        where `carry` has less of it."""
        self.taught = nn.Parameter(torch.ones(len(captured), n_controls), requires_grad=False)
        """1 where a control moves in a captured emotion as the captures do; 0: as the base. It is
        changed by `teach`."""
        self.is_whole = True
        """Whether every control moves as captured in every captured emotion."""
        hook: Callable[..., object] = self.register_load_state_dict_post_hook
        hook(lambda module, _: module.teach(module.taught))

    @torch.no_grad()
    def teach(self, taught: Tensor) -> None:
        """Set where controls move as captured [shape=(5, C)]."""
        self.taught.copy_(taught)
        self.is_whole = bool((self.taught == 1).all())

    def captured(self, emotion: Tensor) -> Tensor:
        """The styles, the weights of emotions that captures lack given to the reference."""
        return self._moved(emotion, self.is_captured)

    def plain(self, emotion: Tensor) -> Tensor:
        """The styles, all weights of emotions given to the reference."""
        return self._moved(emotion, torch.zeros_like(self.is_captured))

    def _moved(self, emotion: Tensor, stays: Tensor) -> Tensor:
        weights, actors = emotion[..., : len(stays)], emotion[..., len(stays) :]
        stay = weights * stays.to(weights)
        target = F.one_hot(torch.tensor(self.reference), len(stays)).to(weights)
        moved = (weights - stay).sum(dim=-1, keepdim=True) * target
        return torch.cat((stay + moved, actors), dim=-1)

    def forward(self, change: Tensor, emotion: Tensor, before: Tensor) -> Tensor:
        """Carry a change of the base's curves (B, T, base) to the rig (B, T, C).

        It is that from the styles `before` to `emotion`, each (B, 5 + A) or (B, T, 5 + A).
        """
        size = len(self.pose)
        pose = (emotion[..., :size] - before[..., :size]) @ self.pose
        return F.linear(change, self.carry) + (pose.unsqueeze(1) if pose.dim() == 2 else pose)

    def share(self, emotion: Tensor) -> Tensor:
        """Share of the captured motion in the controls (B, T or 1, C), of its emotions."""
        weights = emotion[..., : len(self.taught)]
        others = weights * (torch.arange(len(self.taught)) != self.reference).to(weights)
        total = others.sum(dim=-1, keepdim=True)
        share: Tensor = torch.where(
            total > 0, others @ self.taught / total.clamp_min(1e-6), torch.ones_like(total)
        )
        return share.unsqueeze(1) if emotion.dim() == 2 else share


class ActorLayers(nn.Module):
    """A last layer of each actor, as a change of that of all (not in the paper).

    A stranger, an actor of no capture, has no change: the last layer itself is the mean actor.

    Parameters
    ----------
    n_actors, n_controls, channels : int
        With 0 channels the change is an offset.
    """

    def __init__(self, n_actors: int, n_controls: int, channels: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.zeros(n_actors, n_controls, channels))
        self.bias = nn.Parameter(torch.zeros(n_actors, n_controls))

    def forward(self, hidden: Tensor, emotion: Tensor) -> Tensor | float:
        """Change (B, T, C) of the curves by their actors; `emotion` as `RigDecoder.forward`."""
        if emotion.dim() == 2:
            emotion = emotion.unsqueeze(1)
        actors = emotion[..., len(EMOTIONS) :]
        if not actors.shape[-1]:
            return 0.0
        if not self.weight.shape[-1]:
            return actors @ self.bias
        each = (hidden @ self.weight.flatten(0, 1).T).view(*hidden.shape[:-1], *self.bias.shape)
        change: Tensor = (actors.unsqueeze(-2) @ (each + self.bias)).squeeze(-2)
        return change
