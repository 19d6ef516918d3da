"""Reads weights of the VQ-VAE, published or written by Tactoscope; distinguished by tensor names and shapes."""

from pathlib import Path

from pipeline.base.errors import FileProblem
from pipeline.base.params import Value
from pipeline.networks.tensor_files import read_tensors
from pipeline.networks.weights import SUFFIX, Weights, is_tactoscope_file, load_tensors, load_weights

KIND = TASK = "vqvae"
_FIRST, _LAST, _CODES = "encoder.0.weight", "decoder.5.weight", "codebook.embedding.weight"


def read_weights(path: Path) -> Weights:
    """Read Tactoscope weights or a state of the released `VQ-VAE-small`; raises FileProblem for any other file."""
    if path.suffix == SUFFIX and is_tactoscope_file(load_tensors(path)[0]):
        return load_weights(path)
    tensors = read_tensors(path).tensors
    if not {_FIRST, _LAST, _CODES} <= tensors.keys():
        raise FileProblem(
            f"not VQ-VAE weights under their original names: {_FIRST}, {_CODES} or {_LAST} is missing", path
        )
    codes, width = tensors[_CODES].shape
    config: dict[str, Value] = {
        "inputs": tensors[_FIRST].shape[1], "outputs": tensors[_LAST].shape[1], "width": width, "codes": codes,
        "half_turn": True,
    }  # fmt: skip
    return Weights(name=path.stem, kind=KIND, config=config, tensors=tensors, card={"task": TASK, "file": path.name})
