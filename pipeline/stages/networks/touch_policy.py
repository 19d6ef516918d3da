"""A controller's command from a tactile image: a small strided CNN, trained to copy an expert
(behaviour cloning).
"""

from itertools import pairwise

from torch import Tensor, nn

# of the input
ROWS = 48
COLS = 64


class TouchPolicy(nn.Module):
    """Commands (n, n_commands) from images (n, inputs, 48, 64) in shares of full brightness.

    `base_channels` channels after the first of `levels` strides, twice as many after the others;
    `hidden_size` features before the command.
    """

    def __init__(
        self,
        *,
        inputs: int = 3,
        n_commands: int = 2,
        base_channels: int = 16,
        levels: int = 3,
        hidden_size: int = 32,
    ) -> None:
        super().__init__()
        widths = [inputs, base_channels, *(2 * base_channels for _ in range(levels - 1))]
        self.body = nn.Sequential(
            *(
                layer
                for narrow, wide in pairwise(widths)
                for layer in (nn.Conv2d(narrow, wide, 3, 2, 1), nn.ReLU(inplace=True))
            )
        )
        # No pooling: the position in the image is the answer.
        self.fc1 = nn.Linear(widths[-1] * (ROWS >> levels) * (COLS >> levels), hidden_size)
        self.fc2 = nn.Linear(hidden_size, n_commands)

    @property
    def onnx_size(self) -> tuple[int, int]:
        """Rows and columns that the network is exported for."""
        return ROWS, COLS

    def forward(self, images: Tensor) -> Tensor:
        """The command of each image."""
        return self.fc2(self.fc1(self.body(images - 0.5).flatten(1)).relu())
