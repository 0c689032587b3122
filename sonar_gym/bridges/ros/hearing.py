"""Readings of ideal ranges and laser scans, without ROS: what the node does with each message."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from acquisition import Ping, Reading, SettingError
from acquisition.arguments import checked
from acquisition.arrays import Floats
from acquisition.limits import SEEDS, Limit, PositiveMetres, Share, check_number
from sonar_gym.bridges.ros.messages import ideal_distances
from sonar_gym.bridges.server.sensors import Sensors
from sonar_gym.sensing.scene import EMPTY_M
from sonar_gym.sensing.sonar import SonarChoice, resolve


class HeardRanges:
    """The sonars of a robot whose simulator gives ideal ranges.

    Args:
        model: name, path or model of the sonars.
        max_range: maximum range, m.
        reflectance: of everything, 0..1; a range does not state it.
        seed: of the random numbers.
    """

    @checked
    def __init__(
        self, model: SonarChoice, max_range: PositiveMetres, reflectance: Share, seed: Annotated[int, SEEDS]
    ) -> None:
        self._sensors, self._reflectance = Sensors(resolve(model), max_range, seed), reflectance
        self._numbers: dict[str, int] = {}

    def hear(
        self, sensors: list[str], distance: Floats, bearing: Floats, time_s: float
    ) -> tuple[list[str], Reading, Floats]:
        """Return the names of the sensors with a measurement, their readings, and the credence of each.

        Args:
            sensors: names of the sensors, (n,).
            distance: true distances, m, (n,): infinite for nothing in range, NaN for no measurement.
            bearing: of what is nearest off the beam axis, which is also taken for its incidence, rad, (n,).
            time_s: time of the pings, s.
        """
        rows = np.flatnonzero(~np.isnan(distance))
        names = [sensors[row] for row in rows]
        run = np.array([self._numbers.setdefault(name, len(self._numbers)) for name in names], dtype=np.int64)
        true = np.where(np.isinf(distance[rows]), EMPTY_M, distance[rows])
        reflectance, time = (np.full(len(rows), value) for value in (self._reflectance, time_s))
        ping = Ping.of(true, bearing[rows], reflectance=reflectance, time=time, run=run)
        return names, *self._sensors.answer(ping)


@checked
def scan_sectors(
    ranges: Floats, angle_min: float, angle_increment: float, range_max: float, count: int, range_min: float = 0.0
) -> tuple[Floats, Floats]:
    """Return distance and bearing of the nearest return in each sector of a scan, m and rad, (count,) each.

    The sectors divide the scan equally; the bearing counts from the middle of the sector. A sector without a return
    within `range_max` is infinitely far, one whose returns all are NaN is NaN. What is too close to measure, -Inf or
    below `range_min`, is at `range_min`.

    Args:
        ranges: of a `sensor_msgs/LaserScan`, m, (n,).
        angle_min: angle of the first, rad.
        angle_increment: between two, rad.
        range_max: maximum range of the scan, m.
        count: number of sectors, at most n.
        range_min: minimum range of the scan, m.
    """
    if ranges.ndim != 1:
        raise SettingError(f"ranges has shape {ranges.shape}, expected (n,)")
    check_number("count", count, Limit(1, len(ranges)), whole=True)
    angles = angle_min + angle_increment * np.arange(len(ranges))
    true, distance, bearing = ideal_distances(ranges, range_min, range_max), np.full(count, np.nan), np.zeros(count)
    for k, rows in enumerate(np.array_split(np.arange(len(ranges)), count)):
        value = np.where(np.isnan(true[rows]), np.inf, true[rows])
        nearest = int(np.argmin(value))
        if not np.all(np.isnan(true[rows])):
            distance[k] = value[nearest]
        if np.isfinite(value[nearest]):
            bearing[k] = angles[rows[nearest]] - 0.5 * (angles[rows[0]] + angles[rows[-1]])
    return distance, bearing
