"""Two results of `tactoscope bench --json` row by row: python benchmarks/compare_results.py EARLIER.json LATER.json.

Lists the rows of EARLIER that are gone, no longer hold, or are worse by more than a tenth; exits with 1 if any is.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from pipeline.racing.regressions import find_regressions, read_measurements


def main(earlier: str, later: str) -> int:
    before, now = read_measurements(Path(earlier)), read_measurements(Path(later))
    worse = find_regressions(before, now, {claim.benchmark for claim in before})
    print(f"{len(before)} rows, {len(worse)} worse", *worse, sep="\n  ")
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:3]))
