"""The recording that comes along."""

from __future__ import annotations

from pathlib import Path

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data" / "recordings" / "first_touch.h5"
