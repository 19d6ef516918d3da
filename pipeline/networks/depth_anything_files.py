"""Reads weights of Depth Anything V2, published or written by Tactoscope.

Accepted are the original files (`depth_anything_v2_vits.pth` and so on), checkpoints of the paper's lab (`latest.pth`),
and safetensors of either. float16 is converted to float32, which a CPU computes about 100 times faster.

The original networks predict relative depth of an image. The lab's fork (MMintLab/depth_anything_v2) predicts the
distance from the camera in metres, as a share of a largest distance that its checkpoints do not state; of a depth
sensor it sees the depth itself. Such files have the optimiser's state, or the fork's contact head.
"""

from pathlib import Path

from pipeline.base.errors import FileProblem
from pipeline.base.params import Value
from pipeline.networks.tensor_files import read_tensors
from pipeline.networks.weights import SUFFIX, Weights, is_tactoscope_file, load_tensors, load_weights
from pipeline.networks.weights_description import read_description

KIND = "depth_anything"
_ENCODERS = {384: "vits", 768: "vitb", 1024: "vitl"}
_CONTACT = "mask_head.mask_head.0.weight"
_DESCRIBED = {"answer": str, "largest_mm": float, "image_content": str, "side": int, "contact": bool}
_FEATURES, _LAST = "depth_head.scratch.output_conv1.weight", "depth_head.scratch.output_conv2.2.weight"


def read_weights(path: Path) -> Weights:
    """Read the weights in a file of any of these kinds; raises FileProblem for any other file."""
    if path.suffix == SUFFIX and is_tactoscope_file(load_tensors(path)[0]):
        return _check_kind(load_weights(path), path)
    table = read_tensors(path)
    tensors = table.tensors
    if not {"pretrained.cls_token", _FEATURES, _LAST} <= tensors.keys():
        raise FileProblem("not Depth Anything V2 weights: tensors pretrained.* and depth_head.* are missing", path)
    width = tensors["pretrained.cls_token"].shape[-1]
    if width not in _ENCODERS:
        raise FileProblem(f"unknown encoder of width {width}; supported are vits, vitb and vitl", path)
    is_fork = _CONTACT in tensors or "optimizer" in table.other_keys
    usual: dict[str, Value] = {"answer": "distance", "image_content": "frame"} if is_fork else {"answer": "relative"}
    # The fork builds its head for the features of the small encoder, whatever the encoder; others cannot be run.
    has_head = _CONTACT in tensors and tensors[_CONTACT].shape[1] == tensors[_FEATURES].shape[1]
    config = {"encoder": _ENCODERS[width], "contact": has_head, **usual, **read_description(path, _DESCRIBED)}
    if not config["contact"]:
        tensors = {name: tensor for name, tensor in tensors.items() if not name.startswith("mask_head.")}
    return Weights(name=path.stem, kind=KIND, config=config, tensors=tensors, card={"task": KIND, "file": path.name})


def _check_kind(weights: Weights, path: Path) -> Weights:
    if weights.kind != KIND:
        raise FileProblem(f"these are weights of {weights.kind!r}, not of Depth Anything V2", path)
    return weights
