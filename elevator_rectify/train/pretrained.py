"""Begin the reader with a recogniser of printed text: `--pretrained PP-OCRv6_rec_small.onnx`.

The file is part of the rapidocr wheel (`config/requirements-train.txt`); its weights are PaddleOCR's, Apache 2.0.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import numpy_helper
from torch import Tensor, nn

from elevator_rectify.train.reader_net import Squeeze, TextFeatures
from elevator_rectify.train.start import moments

# The recogniser's colours have this share of the spread of ours.
_CONTRAST = 0.5


def begin_with_recogniser(features: TextFeatures, model: Path, views: Iterable[Tensor]) -> None:
    """Give the layers the recogniser's weights, and normalisations that bring what its layers say of the views.

    So rectifiers and strides may be other than the recogniser's.
    """
    published = TextFeatures(as_published=True)
    weights = _weights(onnx.load(str(model)).graph)
    for net in (published, features):
        convolutions = [m for m in net.modules() if isinstance(m, nn.Conv2d)]
        for layer, (weight, bias) in zip(convolutions, weights, strict=False):
            layer.weight.data.copy_(torch.from_numpy(weight.copy()))
            if layer.bias is not None:
                layer.bias.data.copy_(torch.from_numpy(bias.reshape(-1).copy()))
        convolutions[0].weight.data.mul_(_CONTRAST)
        for squeeze in (m for m in net.modules() if isinstance(m, Squeeze)):
            squeeze.hard_sigmoid()
    for norm, (mean, variance) in zip(_norms(features), moments(published, _norms(published), views), strict=True):
        norm.weight.data.copy_(variance.sqrt())
        norm.bias.data.copy_(mean)
        norm.running_mean.copy_(mean)
        norm.running_var.copy_(variance)


def _norms(net: nn.Module) -> list[nn.BatchNorm2d]:
    return [m for m in net.modules() if isinstance(m, nn.BatchNorm2d)]


def _weights(graph: Any) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """Return (weight, bias) of the convolutions, in their order."""
    stored = {i.name: i for i in graph.initializer}
    maker = {name: node for node in graph.node for name in node.output}

    def constant(name: str) -> NDArray[Any]:
        while name not in stored:
            name = maker[name].input[0]
        return np.asarray(numpy_helper.to_array(stored[name]))

    found = []
    for node in graph.node:
        if node.op_type != "Conv":
            continue
        if len(node.input) > 2:
            bias = node.input[2]
        else:
            add = next(n for n in graph.node if node.output[0] in n.input)
            bias = next((i for i in add.input if i != node.output[0]), node.input[1])
        found.append((constant(node.input[1]), constant(bias)))
    return found
