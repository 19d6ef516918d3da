"""A compact U-Net for pictures of any size: fields of the same size come out.

The pixels of a patch of `fold` x `fold` become channels at the entrance and pixels again at the exit: nothing is
thrown away, and no convolution runs at the full size, where most of the time would go. Encoder and decoder meet at
every level, by a sum; a level halves the picture (rounded up) and widens it. Some 0.3 to 1 million parameters.
"""

from __future__ import annotations

from itertools import pairwise
from typing import cast

from torch import Tensor, nn
from torch.nn import functional


class CompactUnet(nn.Module):
    """Fields (n, outputs, rows, cols) from a picture (n, inputs, rows, cols); plain numbers, no activation at the end.

    `first` channels behind the fold, twice as many at every further of the `levels`, `widest` at most.
    """

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
        self.start = _block(inputs * fold * fold, widths[0])
        self.down = nn.ModuleList(
            nn.Sequential(_block(narrow, wide), _block(wide, wide)) for narrow, wide in pairwise(widths)
        )
        # What comes up is thinned out before it is enlarged: a 1 x 1 convolution costs a quarter there.
        self.thin = nn.ModuleList(nn.Conv2d(wide, narrow, 1) for narrow, wide in pairwise(widths))
        self.merge = nn.ModuleList(nn.Sequential(_block(width, width), _block(width, width)) for width in widths[:-1])
        self.finish = nn.Conv2d(widths[0], outputs * fold * fold, 3, padding=1)

    def forward(self, picture: Tensor) -> Tensor:
        """The fields (n, outputs, rows, cols) of a batch of pictures."""
        rows, cols = picture.shape[-2:]
        beyond = (0, -cols % self.fold, 0, -rows % self.fold)
        whole = functional.pad(picture, beyond, mode="replicate") if any(beyond) else picture
        seen = [cast("Tensor", self.start(functional.pixel_unshuffle(whole, self.fold)))]
        for down in self.down:
            seen.append(down(functional.max_pool2d(seen[-1], 2, ceil_mode=True)))
        field = seen.pop()
        for thin, merge in zip(reversed(self.thin), reversed(self.merge), strict=True):
            beside = seen.pop()
            field = functional.interpolate(thin(field), size=beside.shape[-2:], mode="bilinear", align_corners=False)
            field = merge(beside + field)
        return functional.pixel_shuffle(self.finish(field), self.fold)[..., :rows, :cols]


def _block(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1, bias=False), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)
    )
