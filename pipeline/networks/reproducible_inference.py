"""Run networks by torch so that the same inputs give the same bytes."""

import contextlib
from collections.abc import Generator


@contextlib.contextmanager
def reproducible_inference(n_threads: int = 1) -> Generator[None, None, None]:
    """Run torch without gradients on `n_threads`, whose number changes the last digits of sums.

    On a busy machine one thread is also the fastest: threads wait for each other at every layer.
    """
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(n_threads)
    try:
        with torch.inference_mode():
            yield
    finally:
        torch.set_num_threads(before)
