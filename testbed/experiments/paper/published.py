"""What Mäkinen et al. 2023 measured: the numbers of Tables 2, 3 and 4, and what Figures 5 to 9 show.

Errors are absolute values seen in the picture, between tool marker and object, in camera axes.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Published(NamedTuple):
    """One column of a table: the single measurements where the paper gives them, and its own mean."""

    name: str
    values: tuple[float, ...]
    mean: float

    @property
    def spread(self) -> tuple[float, float, float] | None:
        """Standard deviation, 5 % and 95 % percentile, None where there is only a mean."""
        if len(self.values) < 2:
            return None
        values: NDArray[np.float64] = np.array(self.values)
        return float(values.std(ddof=1)), *(float(p) for p in np.percentile(values, (5.0, 95.0)))  # type: ignore[return-value]


TABLE_2 = (
    Published("rotation x, °", (1.40, 0.71, 0.72, 2.40, 2.03, 2.83, 0.77, 1.28, 1.74), 1.58),
    Published("rotation y, °", (2.75, 0.94, 1.33, 1.52, 2.21, 1.50, 1.83, 1.25, 1.08), 1.57),
    Published("rotation z, °", (14.25, 3.11, 5.91, 8.59, 11.59, 9.18, 1.82, 3.50, 2.07), 6.64),
    Published("x, mm", (27, 37, 45, 4, 4, 12, 3, 27, 36), 24),
    Published("y, mm", (21, 66, 42, 28, 11, 23, 2, 29, 37), 29),
    # The ninth of ten measurements is not listed; the means printed are not quite those of the nine.
    Published("z, mm", (404, 334, 321, 387, 342, 611, 338, 303, 424), 338),
)
TABLE_3_MEAN = (Published("x, mm", (), 3.7), Published("y, mm", (), 1.8), Published("z, mm", (), 14.2))
TABLE_3_MAXIMUM = (Published("x, mm", (), 21.9), Published("y, mm", (), 25.4), Published("z, mm", (), 58.2))
TABLE_4_FIRST = (
    Published("x, mm", (8.1, 11.4, 6.4, 4.1, 0.4, 5.9, 11.3, 6.0, 17.1, 5.6), 7.6),
    Published("y, mm", (19.3, 30.4, 29.4, 35.2, 27.6, 26.2, 22.3, 25.6, 30.8, 26.8), 27.4),
    Published("z, mm", (95.4, 67.3, 110.1, 91.8, 91.5, 111.0, 91.8, 110.9, 103.9, 85.5), 95.9),
)
TABLE_4_SECOND = (
    Published("x, mm", (5.9, 2.9, 5.1, 5.7, 3.6, 2.8, 0.5, 1.0, 0.6, 4.9), 3.3),
    Published("y, mm", (1.9, 3.0, 0.8, 1.1, 0.7, 0.9, 0.2, 0.8, 0.8, 1.5), 1.2),
    Published("z, mm", (89.4, 112.7, 83.8, 105.9, 93.9, 79.8, 79.0, 97.6, 97.6, 89.2), 92.3),
)

FIGURES = {
    "fig5": "Euler angles of the tool marker against the object before and after the orientation adjustment: "
    "one input drives two of the three close to zero; samples at zero are failed detections.",
    "fig6": "The circle, wanted and driven, and the way to the reference: the driven path clearly resembles "
    "a circle but is not completely planar.",
    "fig7": "Position errors over the line equation: x and y come down to a few centimetres; the depth "
    "is not treated.",
    "fig8": "The path wanted, by the encoders, and by the camera after the match: the calibrated camera "
    "follows the encoders.",
    "fig9": "Position errors over two inputs after the match: the first does not bring x and y under 10 mm, "
    "the second does; the depth keeps an offset.",
}
"""What each figure shows in the paper, in words."""
