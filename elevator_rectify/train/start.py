"""Begin a training with the weights of an exported network: `--start detector.onnx`.

An exported network has no batch normalisations. They are put back so that the network says the same as before: each
takes the mean and the spread that its input has on some batches off, and puts them on again.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn

# Channels that never change do not divide by nothing.
_LEAST_VARIANCE = 1e-8


def begin_with(net: nn.Module, model: Path, inputs: Iterable[Tensor]) -> list[str]:
    """Give the network the weights of an exported one; return the names of those that it has not, or of another shape.

    inputs: batches of what the network will see, by which the normalisations are set.
    """
    stored = {i.name: torch.tensor(numpy_helper.to_array(i)) for i in onnx.load(str(model)).graph.initializer}
    new = []
    pairs = []
    for name, layer, norm in _layers(net):
        weight, bias = stored.get(f"{name}.weight"), stored.get(f"{name}.bias")
        if weight is None or bias is None or weight.shape != layer.weight.shape:
            new.append(name)
            continue
        layer.weight.data.copy_(weight)
        (layer if norm is None else norm).bias.data.copy_(bias)
        if norm is not None and layer.bias is not None:
            layer.bias.data.zero_()
        if norm is not None:
            norm.weight.data.fill_((1.0 + norm.eps) ** 0.5)
            pairs.append(norm)
    _normalise(net, pairs, inputs)
    return new


def _layers(net: nn.Module) -> Iterator[tuple[str, nn.Conv2d | nn.Linear, nn.BatchNorm2d | None]]:
    """Yield every layer with weights, by its name, with the normalisation behind it."""
    modules = [(name, m) for name, m in net.named_modules() if isinstance(m, (nn.Conv2d, nn.Linear, nn.BatchNorm2d))]
    for k, (name, module) in enumerate(modules):
        if isinstance(module, (nn.Conv2d, nn.Linear)):
            behind = modules[k + 1][1] if k + 1 < len(modules) else None
            yield name, module, behind if isinstance(behind, nn.BatchNorm2d) else None


def moments(net: nn.Module, norms: list[nn.BatchNorm2d], inputs: Iterable[Tensor]) -> list[tuple[Tensor, Tensor]]:
    """Return mean and variance (C,) of what comes to each normalisation of the network in evaluation mode."""
    seen: dict[nn.Module, list[Tensor]] = {norm: [] for norm in norms}

    def note(norm: nn.Module, given: tuple[Tensor, ...]) -> None:
        seen[norm].append(torch.stack([given[0].mean(dim=(0, 2, 3)), (given[0] ** 2).mean(dim=(0, 2, 3))]))

    hooks = [norm.register_forward_pre_hook(note) for norm in norms]
    net.eval()
    with torch.no_grad():
        for batch in inputs:
            net(batch)
    for hook in hooks:
        hook.remove()
    means = [torch.stack(seen[norm]).mean(dim=0) for norm in norms]
    return [(mean, (squares - mean**2).clamp(min=_LEAST_VARIANCE)) for mean, squares in means]


def _normalise(net: nn.Module, norms: list[nn.BatchNorm2d], inputs: Iterable[Tensor]) -> None:
    """Let each normalisation, which does nothing yet, know its input's mean and variance and put them on again."""
    for norm, (mean, variance) in zip(norms, moments(net, norms, inputs), strict=True):
        norm.running_mean.copy_(mean)
        norm.running_var.copy_(variance)
        norm.weight.data.copy_((variance + norm.eps).sqrt())
        norm.bias.data.add_(mean)
