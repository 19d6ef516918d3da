"""Task: Depth Anything V2 for one sensor, trained as in the paper: SiLog of the depth, cross
entropy of the contact.

SiLog is of the indentation, image by image and in contact: small differences count. That of the
lab's fork (MMintLab/depth_anything_v2) is of the distance from the camera over all pixels, with one
mean for the whole batch.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pipeline.core.arrays import Floats, Image, Mask
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.params import setting
from pipeline.lab.training.distributed import unwrap_network
from pipeline.lab.training.recorded_pairs import RecordedPair, derive_contact
from pipeline.lab.training.task import Task, weigh_terms
from pipeline.physics.sensor_images import render_reference, render_sensor_image
from pipeline.physics.simulation import poses, shapes, variation
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.spec import load_sensor
from pipeline.stages.networks.depth_anything_input import prepare_image, resize_to_patches

if TYPE_CHECKING:
    from torch import Tensor, nn

    from pipeline.lab.training.task import Example, Split

ImageContent = Literal["image", "difference"]
_OFFSET_MM = 0.1  # added to the indentation before the logarithm, which bounds it at zero
_SILOG_SHARE = 0.5  # of the squared mean that does not count, as in the paper
_SILOG_EPS = 1e-8  # under the root: the gradient of a perfect prediction is zero instead of NaN


@frozen
class DepthAnythingTask(Task):
    """Settings of the examples and weights of the loss."""

    sensor: str = setting("gelslim", "Sensor")
    side: int = setting(140, "Shorter side", unit="px", low=28, high=1400, step=14)
    image_content: ImageContent = setting("image", "Image content", choices=ImageContent)
    largest_mm: float = setting(
        2.0,
        "Largest depth",
        unit="mm",
        low=0.01,
        high=1000.0,
        help="that the network's output 1 stands for",
    )

    def sample(self, rng: np.random.Generator) -> Example:
        """A training object in one of the paper's poses, on another sensor instance."""
        return self._simulate_example(rng, shapes.list_shapes("training"))

    @property
    def pair_sensors(self) -> tuple[str, str]:
        """The sensor, which is paired with its own truth."""
        return self.sensor, self.sensor

    def prepare_pair(self, pair: RecordedPair) -> Example | None:
        """The example of a recorded touch; None where its depth is not recorded."""
        frame = pair.source_frame
        truth = pair.target_truth
        if truth is None or truth.indentation_mm is None:
            return None
        reference = render_reference(pair.source) if frame.reference is None else frame.reference
        contact = derive_contact(truth, pair.source)
        indentation_mm = np.nan_to_num(truth.indentation_mm)
        return self._make_example(frame.image, reference, indentation_mm, contact)

    def make_validation_example(self, split: Split, index: int) -> Example:
        """A training object in a new pose, or an unseen tool."""
        group = "training" if split == "unseen_grasps" else "unseen"
        return self._simulate_example(
            np.random.default_rng([17, len(split), index]), shapes.list_shapes(group)
        )

    def _simulate_example(self, rng: np.random.Generator, names: Sequence[str]) -> Example:
        mesh = shapes.make_shape(names[int(rng.integers(len(names)))]).mesh
        seeds = [int(seed) for seed in rng.integers(2**31, size=4)]
        sensor = variation.vary_sensor(load_sensor(self.sensor), seeds[0])
        press = simulate_press(
            mesh, poses.make_paper_grid(mesh, n=1, seed=seeds[1])[0], sensor, seed=seeds[2]
        )
        flat = np.zeros(sensor.camera.shape, np.float32)
        reference = render_sensor_image(sensor, flat, sensor.rest_depth_mm, seeds[3])
        return self._make_example(press.image, reference, press.indentation_mm, press.contact)

    def _make_example(
        self,
        image: Image | Floats,
        reference: Image | Floats,
        indentation_mm: Floats,
        contact: Mask,
    ) -> Example:
        shown = prepare_image(image, reference, self.image_content)
        parts: list[Floats] = [
            resize_to_patches(p, self.side)
            for p in (shown, indentation_mm, contact.astype(np.float32))
        ]
        return {
            "image": np.ascontiguousarray(parts[0].transpose(2, 0, 1)),
            "indentation_mm": parts[1],
            "contact": (parts[2] > 0.5).astype(np.float32),
        }

    def compute_loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, dict[str, Any]]:
        """SiLog, cross entropy of the contact, and the absolute error in mm."""
        from torch.nn import functional

        if unwrap_network(network).answer != "metric":
            raise SettingProblem('answer must be "metric" in [network]: indentation is trained')
        depth, logit = network(batch["image"])
        predicted = self.largest_mm * depth
        truth = batch["indentation_mm"]
        contact = batch["contact"]
        silog = compute_silog_loss(
            predicted + _OFFSET_MM,
            truth + _OFFSET_MM,
            contact,
            share=_SILOG_SHARE,
            least=_OFFSET_MM / 2,
        )
        entropy = functional.binary_cross_entropy_with_logits(logit, contact)
        return weigh_terms({"silog": (1.0, silog), "contact": (1.0, entropy)})

    def evaluate(self, network: nn.Module, held_out: Sequence[Example]) -> dict[str, float]:
        """Contact IoU, and mean error of the indentation in contact."""
        import torch

        errors = 0.0
        n_contact = n_both = n_either = 0
        for example in held_out:
            depth, logit = network(torch.from_numpy(example["image"])[None])
            predicted = logit[0].numpy() > 0
            contact = example["contact"] > 0.5
            indentation_mm = self.largest_mm * depth[0].numpy()
            errors += float(np.abs(indentation_mm - example["indentation_mm"])[contact].sum())
            n_contact += np.count_nonzero(contact)
            n_both += np.count_nonzero(predicted & contact)
            n_either += np.count_nonzero(predicted | contact)
        return {
            "contact IoU": n_both / max(n_either, 1),
            "error in contact, um": 1e3 * errors / max(n_contact, 1),
        }


def compute_silog_loss(
    predicted: Tensor, truth: Tensor, counted: Tensor, *, share: float, least: float
) -> Tensor:
    """The paper's scale-invariant logarithmic loss (Eigen et al. 2014), in a form with a gradient
    everywhere.

    Mean over the images (n, rows, cols) of sqrt(mean d^2 - share mean(d)^2), d = log predicted -
    log truth, over the `counted` pixels (n, rows, cols, 0 or 1) of images that have any. Depths
    below `least` count as `least`. Computed as variance + (1 - share) mean^2, which rounding cannot
    make negative.
    """
    import torch

    predicted = predicted.float().clamp(min=least)
    truth = truth.float().clamp(min=least)
    difference = (torch.log(predicted) - torch.log(truth)) * counted
    n = counted.sum((1, 2))
    mean = difference.sum((1, 2)) / n.clamp(min=1.0)
    variance = ((difference - mean[:, None, None]) ** 2 * counted).sum((1, 2)) / n.clamp(min=1.0)
    each = torch.sqrt(variance + (1.0 - share) * mean**2 + _SILOG_EPS)
    has_any = (n > 0).float()
    return (each * has_any).sum() / has_any.sum().clamp(min=1.0)
