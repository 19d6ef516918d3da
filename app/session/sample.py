"""The sample recording of the distribution."""

from __future__ import annotations

from pathlib import Path

SAMPLE_RECORDING = Path(__file__).resolve().parents[2] / "sample_data" / "recordings" / "first_touch.h5"
