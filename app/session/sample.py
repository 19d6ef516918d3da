"""The sample recording of the distribution."""

from pathlib import Path

SAMPLE_RECORDING = (
    Path(__file__).resolve().parents[2] / "sample_data" / "recordings" / "first_touch.h5"
)
