"""A compact U-Net for images of any size; the output has the size of the input.

Each patch of `fold` x `fold` pixels becomes channels at the input and pixels again at the output:
nothing is lost, and no convolution runs at full resolution, where most of the time would go.
Encoder and decoder are joined by a sum at every level; a level halves the image (rounded up) and
widens the channels. 0.3 to 1 million parameters.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.nn import functional


class CompactUnet(nn.Module):
    """Fields (n, outputs, rows, cols) of an image (n, inputs, rows, cols).

    No activation at the end.

    `base_channels` after the fold, doubled at each further of the `levels`, at most `max_channels`.
    """

    # (rows, cols) for which it is exported; None: one file serves any size that `fold` divides
    onnx_size = None

    def __init__(
        self,
        *,
        inputs: int,
        outputs: int,
        base_channels: int = 32,
        levels: int = 4,
        max_channels: int = 120,
        fold: int = 2,
    ) -> None:
        super().__init__()
        widths = [min(base_channels * 2**level, max_channels) for level in range(levels)]
        self.fold = fold
        self.inputs = inputs
        self.register_buffer("fold_kernel", make_fold_kernel(inputs, fold), persistent=False)
        self.start = _block(inputs * fold * fold, widths[0])
        self.down = nn.ModuleList(
            nn.Sequential(_block(narrow, wide), _block(wide, wide))
            for narrow, wide in pairwise(widths)
        )
        # Channels are reduced before the image is enlarged: a 1 x 1 convolution costs a quarter
        # there.
        self.thin = nn.ModuleList(nn.Conv2d(wide, narrow, 1) for narrow, wide in pairwise(widths))
        self.merge = nn.ModuleList(
            nn.Sequential(_block(width, width), _block(width, width)) for width in widths[:-1]
        )
        self.finish = nn.Conv2d(widths[0], outputs * fold * fold, 3, padding=1)

    def forward(self, image: Tensor) -> Tensor:
        """The fields (n, outputs, rows, cols) of a batch of images."""
        kernel = cast("Tensor", self.fold_kernel)

        def fold(padded: Tensor) -> Tensor:
            return functional.conv2d(padded, kernel, stride=self.fold, groups=self.inputs)

        return run_unet(self, image, fold)


def run_unet(
    net: Any, image: Tensor, fold: Callable[[Tensor], Tensor], *embedding: Tensor
) -> Tensor:
    """The fields (n, outputs, rows, cols) of a network with the parts of a `CompactUnet`.

    `fold` turns patches of the padded image into channels; every block gets the `embedding`, too.
    """
    rows, cols = (int(n) for n in image.shape[-2:])
    padding = (0, -cols % net.fold, 0, -rows % net.fold)
    if any(padding):
        image = functional.pad(image, padding, mode="replicate")
    skips: list[Tensor] = [net.start(fold(image), *embedding)]
    for down in net.down:
        skips.append(down(functional.max_pool2d(skips[-1], 2, ceil_mode=True), *embedding))
    field = skips.pop()
    for thin, merge in zip(reversed(net.thin), reversed(net.merge), strict=True):
        skip = skips.pop()
        field = functional.interpolate(
            thin(field), size=skip.shape[-2:], mode="bilinear", align_corners=False
        )
        field = merge(skip + field, *embedding)
    fields = functional.pixel_shuffle(net.finish(field), net.fold)
    return fields[..., :rows, :cols] if any(padding) else fields


def make_fold_kernel(inputs: int, fold: int) -> Tensor:
    """Pixels to channels as a convolution: OpenCV runs it for any size, which it does not for
    torch's own export.
    """
    return torch.eye(fold * fold).reshape(fold * fold, 1, fold, fold).repeat(inputs, 1, 1, 1)


def _block(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(inplace=True),
    )
