"""Success rates with their intervals."""

import math

Z_95 = 1.959963984540054  # standard normal quantile of 0.975


def compute_wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """The 95 % interval of a success rate (Wilson 1927); (0, 1) without trials."""
    if not trials:
        return 0.0, 1.0
    share, spread = successes / trials, Z_95**2 / trials
    middle = (share + 0.5 * spread) / (1.0 + spread)
    half = Z_95 * math.sqrt(share * (1.0 - share) / trials + 0.25 * spread / trials) / (1.0 + spread)
    return max(0.0, middle - half), min(1.0, middle + half)
