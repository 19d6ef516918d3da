"""The loss of imprints without a scale: whatever the scale, and nothing for the mean that all imprints have."""

import numpy as np
import pytest
import torch

from pipeline.training.correlation_loss import compute_correlation_loss

ROWS, COLS = 12, 16
RNG = np.random.default_rng(0)
TRUE, MEAN = RNG.normal(size=(3, ROWS, COLS)).astype(np.float32), RNG.normal(size=(ROWS, COLS)).astype(np.float32)


class Answers(torch.nn.Module):
    sigma_max = most = 10.0

    def __init__(self, field):
        super().__init__()
        self.field = torch.from_numpy(np.broadcast_to(field, TRUE.shape).astype(np.float32))

    def forward(self, noisy, sigma, condition):
        assert not noisy.any(), "nothing is shown at the strongest noise"
        return torch.stack([self.field] * 3, 1)


@pytest.mark.parametrize(
    ("said", "unlike"),
    [(TRUE, 0.0), (3.0 * TRUE - 5.0, 0.0), (TRUE + 4.0 * MEAN, 0.0), (-TRUE, 2.0), (MEAN, 1.0)],
    ids=["truth", "scaled", "with the mean", "reversed", "the mean alone"],
)
def test_only_what_is_beside_the_mean_imprint_counts_at_any_scale(said, unlike):
    batch = {"residual": torch.from_numpy(np.stack([TRUE, TRUE], 1)), "condition": torch.zeros(3, 2, ROWS, COLS)}
    _, parts = compute_correlation_loss(Answers(said), batch, MEAN, 1.0)
    assert float(parts["unlike"]) == pytest.approx(unlike, abs=0.02)
