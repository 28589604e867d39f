"""Curves whose lips do on the head what was measured on people.

Letters: T frames at 30 per second, C controls, M measures.
"""

import torch
from torch import Tensor

from deitalk.research.lips.head_lips import HeadLips
from rig import ControlSet

ITERATIONS = 8


def nearest_curves(
    prior: Tensor,
    measures: Tensor,
    face: HeadLips,
    loose: Tensor,
    tolerance: Tensor,
    controls: ControlSet,
) -> Tensor:
    """Curves nearest a prior with which a head does what was measured.

    Bounded least squares by Gauss-Newton steps.

    Parameters
    ----------
    prior : Tensor [shape=(T, C)]
        What the measures leave open stays as it is.
    measures : Tensor [shape=(T, M)]
        Displacements from rest, cm; rows with NaN leave the frame as in the prior.
    face : HeadLips
        The head; its `displacements` are the measures of curves.
    loose : Tensor [shape=(C,)]
        How far controls readily move; 0 keeps one.
    tolerance : Tensor [shape=(M,)], cm
        Error of each measure that costs as much as a control moved by its looseness.
    controls : ControlSet
        Columns of `prior`.

    Returns
    -------
    Tensor [shape=(T, C)]
        Within the ranges of the controls.
    """
    low, high = torch.tensor(controls.minimum), torch.tensor(controls.maximum)
    loose, noise = loose.square(), torch.diag(tolerance.square())
    known = torch.isfinite(measures).all(dim=1, keepdim=True)
    wanted = torch.where(known, measures, 0.0)
    curves, free = prior, torch.ones_like(prior)
    for _ in range(ITERATIONS):
        given, slope = _linearised(face, curves)
        slope = slope * free[:, None]
        back = (slope @ (curves - prior)[..., None])[..., 0]
        moved = slope * loose
        solved = torch.linalg.solve(moved @ slope.transpose(1, 2) + noise, wanted - given + back)
        step = (solved[:, None] @ moved)[:, 0]
        aim = torch.where(free > 0, prior + step * known, curves)
        curves = aim.clamp(low, high)
        free = free * (aim == curves)  # a control at the end of its range stays; others make up
    return curves


def _linearised(face: HeadLips, curves: Tensor) -> tuple[Tensor, Tensor]:
    """Displacements (T, M) of a head by curves, and their slopes (T, M, C)."""
    with torch.enable_grad():
        point = curves.detach().requires_grad_(True)
        given = face.displacements(point)
        last = given.shape[1] - 1
        slopes = [
            torch.autograd.grad(given[:, i].sum(), point, retain_graph=i < last)[0]
            for i in range(last + 1)
        ]
    return given.detach(), torch.stack(slopes, dim=1)
