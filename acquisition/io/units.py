"""Units of a recording that are valid numbers but cannot be right, such as metres in a column of millimetres."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from acquisition.io.recording import Recording

MIN_RANGE_MM = 20.0  # least range of an HC-SR04 by its data sheet; no ultrasonic ranger here measures less
MIN_DISTANCE = 1e-9  # m; shorter distances have no ratio
MAX_RATIO_ERROR = 0.15  # relative deviation of reading / distance from a power of ten; more than any scale error


def doubtful_units(recording: Recording) -> Iterator[str]:
    """Yield one sentence for each column, or pair of columns, whose unit seems wrong."""
    distance_mm = 1000.0 * recording.ping.distance
    reading_mm = 1000.0 * recording.reading.range[recording.reading.echo]
    small = [
        name
        for name, value in (("distance_mm", distance_mm), ("reading_mm", reading_mm))
        if len(value) and 0.0 < value.max() < MIN_RANGE_MM
    ]
    for name in small:
        yield (
            f"{recording.name}: no value of {name} exceeds {MIN_RANGE_MM:.0f} mm, so the column may be in metres; "
            f"multiply it by 1000, or import it with its unit, {name}=...:m."
        )
    reading, distance = recording.reading.range, recording.ping.distance
    long = (reading > MIN_DISTANCE) & (distance > MIN_DISTANCE)
    if len(small) == 2 or not long.any():
        return
    ratio = float(np.median(reading[long] / distance[long]))
    power = round(np.log10(ratio))
    if power and abs(ratio / 10.0**power - 1.0) < MAX_RATIO_ERROR:
        yield (
            f"{recording.name}: reading_mm is {10.0**power:g} times distance_mm in the median, so the columns may have "
            "different units; both must be in mm."
        )
