"""Published and own weights of Depth Anything V2: told apart by the names and shapes of their tensors.

The original's files (`depth_anything_v2_vits.pth` and so on), the paper's with a contact head, and safetensors of
either; halves become float32, which this processor computes a hundred times faster.
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
    """The weights in a file of any of those kinds; raises FileProblem where it is none of them."""
    if path.suffix == SUFFIX:
        metadata, tensors = load_tensors(path)
        if is_tactoscope_file(metadata):
            return _checked(load_weights(path), path)
    else:
        tensors = read_tensors(path)
    tensors = {name.removeprefix("module."): tensor for name, tensor in tensors.items()}
    if "pretrained.cls_token" not in tensors or _LAST not in tensors:
        raise FileProblem(
            "these are no weights of Depth Anything V2 under their original names (pretrained.*, depth_head.*)", path
        )
    width = tensors["pretrained.cls_token"].shape[-1]
    if width not in _ENCODERS:
        raise FileProblem(f"an encoder {width} wide is not known here; there are vits, vitb and vitl", path)
    config: dict[str, Value] = {"encoder": _ENCODERS[width], "contact": _CONTACT in tensors}
    # What came with a contact head was taught in metric depth; the general models answer without a unit.
    config["answer"] = "metric" if _CONTACT in tensors else "relative"
    return Weights(name=path.stem, kind=KIND, config=config, tensors=tensors, card={"task": KIND, "file": path.name})


def _checked(weights: Weights, path: Path) -> Weights:
    if weights.kind != KIND:
        raise FileProblem(f"these are weights of {weights.kind!r}, not of Depth Anything V2", path)
    return weights
