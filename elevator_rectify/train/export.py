"""Write a checkpoint's averaged network as ONNX: `python -m elevator_rectify.train.export detector.pt detector.onnx`.

A file that ends in .xz is compressed: of weights that are rounded to half precision half the bits are zero.

Batch normalisations are folded into the convolutions before them, weights are rounded to half precision.
OpenCV reads both files from version 4.6 on, which takes no Identity on constants.
"""

from __future__ import annotations

import argparse
import lzma
from pathlib import Path

import onnx
import torch
from onnx import TensorProto, numpy_helper
from torch import Tensor, nn

from elevator_rectify.core.lamps.patches import SIDE
from elevator_rectify.core.reading.attitude import SIDE_PX
from elevator_rectify.core.reading.reader import PATCH_PX
from elevator_rectify.train.attitude_net import AttitudeNet
from elevator_rectify.train.detector_net import DetectorNet
from elevator_rectify.train.lit_net import LitNet
from elevator_rectify.train.reader_net import ReaderNet


def folded(net: nn.Module) -> nn.Module:
    """Return the network in evaluation mode with every batch normalisation folded into its convolution."""
    net.eval()
    for module in net.modules():
        if isinstance(module, nn.Sequential):
            for k in range(len(module) - 1):
                if isinstance(module[k], nn.Conv2d) and isinstance(module[k + 1], nn.BatchNorm2d):
                    module[k] = torch.nn.utils.fusion.fuse_conv_bn_eval(module[k], module[k + 1])
                    module[k + 1] = nn.Identity()
    return net


def without_identities(net: nn.Module) -> nn.Module:
    """Return the network whose sequences have no empty steps."""
    for name, module in net.named_children():
        if isinstance(module, nn.Sequential):
            kept = nn.Sequential(*(m for m in module if not isinstance(m, nn.Identity)))
            setattr(net, name, kept)
            without_identities(kept)
        else:
            without_identities(module)
    return net


def export(checkpoint: Path, output: Path, side: tuple[int, int]) -> None:
    """Write the network of a checkpoint; side: height and width of the detector's nominal input."""
    state = torch.load(checkpoint, weights_only=True)
    net, shape, names = _network_of(state["average"], side)
    net.load_state_dict(state["average"])
    net = without_identities(folded(net))
    dynamic = None if isinstance(net, DetectorNet) else {name: {0: "n"} for name in names}
    given, said = names
    torch.onnx.export(
        net,
        (torch.zeros(shape),),
        str(output),
        opset_version=10,
        dynamo=False,
        dynamic_axes=dynamic,
        input_names=[given],
        output_names=[said],
    )
    model = onnx.load(str(output))
    halve(model)
    share_constants(model)
    packed = model.SerializeToString()
    output.write_bytes(lzma.compress(packed) if output.suffix == ".xz" else packed)
    print(f"{output}: {output.stat().st_size / 1e6:.2f} MB, step {state['step']}")


def _network_of(
    weights: dict[str, Tensor], side: tuple[int, int]
) -> tuple[nn.Module, tuple[int, ...], tuple[str, str]]:
    """Return the network that has these weights, the shape of its input, and the names of input and output."""
    if "head.weight" in weights:
        return DetectorNet(), (1, 3, *side), ("image", "out")
    if "said.0.weight" in weights:
        return AttitudeNet(), (1, 1, SIDE_PX, SIDE_PX), ("patches", "nats")
    if "odds.weight" in weights:
        return LitNet(), (1, 9, SIDE, SIDE), ("patches", "odds")
    return ReaderNet(), (1, 3, PATCH_PX, PATCH_PX), ("patches", "logits")


def share_constants(model: onnx.ModelProto) -> None:
    """Use constants by their own names: the exporter gives equal ones to each other by Identity."""
    graph, stored = model.graph, {i.name for i in model.graph.initializer}
    other = {n.output[0]: n.input[0] for n in graph.node if n.op_type == "Identity" and n.input[0] in stored}
    for node in [n for n in graph.node if n.op_type == "Identity" and n.output[0] in other]:
        graph.node.remove(node)
    for node in graph.node:
        for k, name in enumerate(node.input):
            node.input[k] = other.get(name, name)


def halve(model: onnx.ModelProto) -> None:
    """Round the weights to half precision; they stay stored as float32, which every reader takes."""
    for tensor in model.graph.initializer:
        if tensor.data_type == TensorProto.FLOAT:
            array = numpy_helper.to_array(tensor)
            tensor.CopyFrom(numpy_helper.from_array(array.astype("float16").astype("float32"), tensor.name))


def main() -> None:
    """Read the command line and export."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--side", type=int, nargs=2, default=(480, 640))
    options = parser.parse_args()
    export(options.checkpoint, options.output, tuple(options.side))


if __name__ == "__main__":
    main()
