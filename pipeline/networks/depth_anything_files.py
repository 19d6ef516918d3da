"""Reads weights of Depth Anything V2, published or written by Tactoscope.

Accepted are the original files (`depth_anything_v2_vits.pth` and so on), the paper's with a contact head, and
safetensors of either. float16 is converted to float32, which a CPU computes about 100 times faster.
"""

from __future__ import annotations

from pathlib import Path

from pipeline.base.errors import FileProblem
from pipeline.base.params import Value
from pipeline.networks.tensor_files import read_tensors
from pipeline.networks.weights import SUFFIX, Weights, is_tactoscope_file, load_tensors, load_weights

KIND = "depth_anything"
_ENCODERS = {384: "vits", 768: "vitb", 1024: "vitl"}
_CONTACT = "mask_head.mask_head.0.weight"
_LAST = "depth_head.scratch.output_conv2.2.weight"


def read_weights(path: Path) -> Weights:
    """Read the weights in a file of any of these kinds; raises FileProblem for any other file."""
    if path.suffix == SUFFIX and is_tactoscope_file(load_tensors(path)[0]):
        return _check_kind(load_weights(path), path)
    tensors = read_tensors(path).tensors
    if "pretrained.cls_token" not in tensors or _LAST not in tensors:
        raise FileProblem("not Depth Anything V2 weights: tensors pretrained.* and depth_head.* are missing", path)
    width = tensors["pretrained.cls_token"].shape[-1]
    if width not in _ENCODERS:
        raise FileProblem(f"unknown encoder of width {width}; supported are vits, vitb and vitl", path)
    config: dict[str, Value] = {"encoder": _ENCODERS[width], "contact": _CONTACT in tensors}
    # Weights with a contact head were trained on metric depth; the general models predict relative depth.
    config["answer"] = "metric" if _CONTACT in tensors else "relative"
    return Weights(name=path.stem, kind=KIND, config=config, tensors=tensors, card={"task": KIND, "file": path.name})


def _check_kind(weights: Weights, path: Path) -> Weights:
    if weights.kind != KIND:
        raise FileProblem(f"these are weights of {weights.kind!r}, not of Depth Anything V2", path)
    return weights
