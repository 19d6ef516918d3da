"""Parameters of the photometric depth, and of a bubble's."""

from pipeline.core.frozen import frozen
from pipeline.core.params import setting


@frozen
class DepthParams:
    """Parameters of the photometric depth."""

    contact_limit: float = setting(
        1.0,
        "Contact limit",
        unit="x",
        low=0.2,
        high=10.0,
        step=0.1,
        help="smallest indentation that counts, in units of the sensor's own limit",
        source="our own; the limit is in the sensor's description",
    )
    pressure_share: float = setting(
        0.25,
        "Pressure share",
        unit="share",
        low=0.02,
        high=0.8,
        step=0.02,
        help="contact is where the pressure exceeds this share of its peak nearby",
        source="Johnson, Contact Mechanics, 1985",
        only="gel",
    )
    smoothing_px: float = setting(
        1.0,
        "Smoothing",
        unit="px",
        low=0.0,
        high=5.0,
        step=0.25,
        help="blur of the colour change, or of a bubble's depth",
        source="a Gaussian's standard deviation; how much is our own",
    )
    sensitivity: float = setting(
        1.0,
        "Sensitivity",
        unit="x",
        low=0.2,
        high=5.0,
        step=0.1,
        help="larger detects weaker touches: divides the sensor's limit of change without contact",
        source="our own; the limit is in the sensor's description",
    )
