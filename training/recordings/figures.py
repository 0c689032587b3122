"""Figures of a recording: credence surfaces (thesis, figures 4.1 and 4.2), readings, detection, time series."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from acquisition import EchoStatus, Recording
from acquisition.arrays import Floats, Ints
from training.common.canvas import AFTER, BEFORE, INK, SOFT, Axes, Draw, Figure, PolarAxes, figure_of, panels

TOLERANCE = 0.10  # a reading is correct within this share of the true distance (Esmi 2016, section 4.1)
MAX_PANELS, MAX_POINTS = 4, 6000
MAX_ANGLES, MAX_DISTANCES = 61, 250  # levels of a surface; more are binned
MAX_HALF_WIDTH_DEG, MAX_HALF_WIDTH = 2.5, 0.04  # of the area of one level: deg, and share of the distance span
BLANK = "#eceff3"
DEG = np.pi / 180.0


@dataclass(frozen=True)
class Levels:
    """Levels of one axis of a surface.

    Attributes:
        index: level of each ping, (n,).
        low: lower edge of each level, (levels,), ascending.
        high: upper edge of each level, (levels,); levels do not overlap.
    """

    index: Ints
    low: Floats
    high: Floats

    @classmethod
    def of(cls, value: Floats, max_levels: int, max_half_width: float) -> Levels:
        """Return the unique values as levels, or `max_levels` equal bins if there are more (a moving robot)."""
        centre, index = np.unique(np.round(value, 6), return_inverse=True)
        if len(centre) > max_levels:
            edges = np.linspace(centre[0], centre[-1], max_levels + 1)
            return cls(np.clip(np.searchsorted(edges, value, "right") - 1, 0, max_levels - 1), edges[:-1], edges[1:])
        half = np.minimum(np.diff(centre) / 2, max_half_width)
        return cls(
            index, centre - np.append(max_half_width, half)[: len(centre)], centre + np.append(half, max_half_width)
        )

    @property
    def edges(self) -> Floats:
        """Return all edges, (2 levels,); the area between two levels was not measured."""
        return np.stack([self.low, self.high], axis=1).ravel()


@dataclass(frozen=True, eq=False)
class Part:
    """Pings of a recording with one reflector.

    Attributes:
        recording: these pings.
        title: description of the reflector.
    """

    recording: Recording
    title: str

    @cached_property
    def angles(self) -> Levels:
        """Levels of bearing, rad."""
        return Levels.of(self.recording.ping.angle, MAX_ANGLES, MAX_HALF_WIDTH_DEG * DEG)

    @cached_property
    def distances(self) -> Levels:
        """Levels of distance, m."""
        distance = self.recording.ping.distance
        span = float(np.ptp(distance)) or float(distance[0])
        levels = Levels.of(distance, MAX_DISTANCES, max(MAX_HALF_WIDTH * span, 0.005))
        return Levels(levels.index, np.maximum(levels.low, 0.0), levels.high)

    @cached_property
    def right(self) -> Floats:
        """1 for readings within 10 % of the truth, else 0, (n,)."""
        ping, reading = self.recording.ping, self.recording.reading
        return (reading.echo & (np.abs(reading.range - ping.distance) <= TOLERANCE * ping.distance)).astype(np.float64)

    def surface(self, value: Floats) -> Floats:
        """Return means over answered pings, (2 angles - 1, 2 distances - 1); nan without any."""
        rows, columns = len(self.angles.low), len(self.distances.low)
        answered = self.recording.reading.answered
        place = (self.angles.index * columns + self.distances.index)[answered]
        count = np.bincount(place, minlength=rows * columns)
        total = np.bincount(place, value[answered], rows * columns)
        mean = np.where(count > 0, total / np.maximum(count, 1), np.nan).reshape(rows, columns)
        out = np.full((2 * rows - 1, 2 * columns - 1), np.nan)
        out[::2, ::2] = mean
        return out


def parts(recording: Recording) -> list[Part]:
    """Return the recording by reflectance, or as one part if there are too many levels."""
    if not recording.has("reflectance"):
        return [Part(recording, "all pings")]
    reflectance = recording.ping.reflectance
    levels = np.unique(reflectance)
    if len(levels) == 1 or len(levels) > MAX_PANELS:
        return [Part(recording, "all reflectors" if len(levels) > 1 else _named(float(levels[0])))]
    return [Part(recording.select(reflectance == level), _named(float(level))) for level in levels[::-1]]


def _named(reflectance: float) -> str:
    thesis = {0.9: " (mirror)", 0.1: " (rubber)"}.get(round(reflectance, 6), "")
    return f"reflectance {reflectance:g}{thesis}"


def _each(recording: Recording, draw: Callable[[Axes, Part], None]) -> list[Draw]:
    """Return one drawing function for each part."""

    def one(part: Part) -> Draw:
        def run(axes: Axes) -> None:
            draw(axes, part)
            # by itself, matplotlib places the title of a wedge outside the figure
            axes.set_title(part.title, fontsize=10, y=0.92 if isinstance(axes, PolarAxes) else None)

        return run

    return [one(part) for part in parts(recording)]


def credence_polar(recording: Recording) -> bytes:
    """Return a figure of credence over bearing and distance, in polar coordinates."""

    def draw(axes: Axes, part: Part) -> None:
        angle, distance = part.angles.edges, part.distances.edges
        axes.pcolormesh(angle, distance, part.surface(part.right).T, vmin=0.0, vmax=1.0, cmap="viridis")
        low, high = min(angle[0] / DEG, -MAX_HALF_WIDTH_DEG), max(angle[-1] / DEG, MAX_HALF_WIDTH_DEG)
        if isinstance(axes, PolarAxes):  # as requested below
            axes.set_theta_zero_location("N" if low < -2 * MAX_HALF_WIDTH_DEG else "E")
            axes.set_thetagrids([mark for mark in range(-180, 181, 15) if low <= mark <= high])
        axes.set(thetamin=low, thetamax=high, rmin=0.0, facecolor=BLANK)
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.35)
        axes.set_xlabel("distance (m), bearing (deg)", fontsize=9)

    draws = _each(recording, draw)
    return panels(draws, (5.2 * len(draws), 4.6), colours=_credence_bar(), projection="polar")


def credence_plane(recording: Recording) -> bytes:
    """Return a figure of credence in the plane, from above; one-sided data are mirrored (symmetric beam)."""

    def draw(axes: Axes, part: Part) -> None:
        distance, value = part.distances.edges, part.surface(part.right)
        one_sided = part.recording.ping.angle.min() >= 0.0
        for side in (1.0, -1.0) if one_sided else (1.0,):
            a, d = np.meshgrid(side * part.angles.edges, distance, indexing="ij")
            axes.pcolormesh(d * np.sin(a), d * np.cos(a), value, vmin=0, vmax=1, cmap="viridis", rasterized=True)
        far, angle = float(distance[-1]), np.abs(part.angles.edges)
        reach = 1.02 * far * max(float(np.sin(np.linspace(angle.min(), angle.max())).max()), 0.15)
        behind = 1.02 * far * min(float(np.cos(angle.max())), 0.0)
        axes.set(aspect="equal", facecolor=BLANK, xlim=(-reach, reach), ylim=(behind, 1.02 * far))
        axes.set(xlabel="to the side (m)", ylabel="ahead of the sonar (m)")
        axes.plot(0.0, 0.0, "^", color=INK, ms=8, clip_on=False)

    draws = _each(recording, draw)
    return panels(draws, (5.2 * len(draws), 4.6), share_y=True, colours=_credence_bar())


def _credence_bar() -> tuple[str, float, float]:
    return (f"credence: readings within {100 * TOLERANCE:.0f} %\nof the truth", 0.0, 1.0)


def detection(recording: Recording) -> bytes:
    """Return a figure of the share of pings with an echo over distance and bearing."""

    def draw(axes: Axes, part: Part) -> None:
        echo = part.surface(part.recording.reading.echo.astype(np.float64))
        if len(part.angles.low) == 1:
            return _along(axes, part, echo)
        angle = part.angles.edges / DEG
        axes.pcolormesh(part.distances.edges, angle, echo, vmin=0, vmax=1, cmap="viridis", rasterized=True)
        axes.set(facecolor=BLANK, xlabel="true distance (m)", ylabel="bearing (deg)")
        return None

    draws = _each(recording, draw)
    return panels(draws, (5.4 * len(draws), 3.6), share_y=True, colours=("share of pings with an echo", 0.0, 1.0))


def _along(axes: Axes, part: Part, share: Floats) -> None:
    """Draw a surface with one bearing as a line over distance."""
    middle = (part.distances.low + part.distances.high) / 2
    axes.plot(middle, share[0, ::2], ".-", color=INK, lw=1.0, ms=4)
    axes.set(xlabel="true distance (m)", ylabel="share of pings with an echo", ylim=(-0.05, 1.05))


def readings(recording: Recording, columns: int = MAX_PANELS) -> bytes:
    """Return a figure of readings against true distance; pings without echo or answer are marked below."""
    draws = _each(recording, _readings)
    columns = min(columns, len(draws))
    return panels(draws, (5.4 * columns, 4.0 * -(-len(draws) // columns)), columns, share_y=True)


def _readings(axes: Axes, part: Part) -> None:
    ping, reading = part.recording.ping, part.recording.reading
    shown = _some(len(ping))
    reach = float(ping.distance.max())
    line = np.array([0.0, 1.05 * reach])
    axes.fill_between(line, 0.9 * line, 1.1 * line, color=AFTER, alpha=0.12, lw=0, label="within 10 %")
    axes.plot(line, line, color=AFTER, lw=0.9, label="the truth")
    top = float(np.quantile(reading.range[reading.echo], 0.999)) if reading.echo.any() else reach
    foot = 0.04 * max(top, reach)
    marks = ((EchoStatus.NO_ECHO, -foot, SOFT, "no echo"), (EchoStatus.NO_ANSWER, -2 * foot, BEFORE, "no answer"))
    echo = shown[reading.echo[shown]]
    axes.plot(ping.distance[echo], reading.range[echo], ".", ms=2.5, color=INK, alpha=0.35, rasterized=True)
    for status, height, colour, label in marks:
        x = ping.distance[shown[reading.status[shown] == status]]
        if len(x):
            axes.plot(x, np.full(len(x), height), "|", ms=5, color=colour, label=label, rasterized=True)
    axes.set(xlabel="true distance (m)", ylabel="reading (m)", ylim=(-3 * foot, 1.08 * max(top, reach)))
    axes.legend(loc="upper left", fontsize=8)


def overview(recording: Recording) -> Figure:
    """Return readings over true distance, for each reflectance, as one figure."""
    draws = _each(recording, _readings)
    return figure_of(draws, (5.4 * len(draws), 4.0))


def course(recording: Recording) -> bytes:
    """Return a figure of errors and logged temperature over time, with consecutive runs."""
    hours, unit = _clock(recording)
    shown = _some(len(recording))
    draws: list[Draw] = [lambda axes: _errors(axes, recording, hours, shown)]
    if "temperature_c" in recording.covariates and np.ptp(recording.table["temperature_c"].to_numpy(np.float64)) > 0:
        draws.append(lambda axes: _temperature(axes, recording, hours, shown))

    def last(axes: Axes) -> None:
        draws[-1](axes)
        axes.set_xlabel(unit)

    return panels([*draws[:-1], last], (9.0, 2.9 * len(draws)), columns=1)


def _errors(axes: Axes, recording: Recording, time: Floats, shown: Ints) -> None:
    reading, error = recording.reading, 1000.0 * (recording.reading.range - recording.ping.distance)
    low, high = np.quantile(error[reading.echo], [0.02, 0.98]) if reading.echo.any() else (-1.0, 1.0)
    room = 0.3 * max(high - low, 5.0)
    echo = shown[reading.echo[shown]]
    inside = np.clip(error[echo], low - room, high + room)
    axes.plot(time[echo], inside, ".", ms=2.5, color=INK, alpha=0.4, rasterized=True)
    marks = ((EchoStatus.NO_ECHO, 1.4, SOFT, "no echo"), (EchoStatus.NO_ANSWER, 1.8, BEFORE, "no answer"))
    for status, place, colour, label in marks:
        x = time[shown[reading.status[shown] == status]]
        if len(x):
            axes.plot(x, np.full(len(x), low - place * room), "|", ms=5, color=colour, label=label, rasterized=True)
    axes.axhline(0.0, color=SOFT, lw=0.8)
    axes.set(ylabel="reading − truth (mm)", ylim=(low - 2.1 * room, high + 1.1 * room))
    axes.set_title("error of each reading; outliers are drawn at the edge", fontsize=9)
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="upper right", fontsize=8)


def _temperature(axes: Axes, recording: Recording, time: Floats, shown: Ints) -> None:
    axes.plot(time[shown], recording.table["temperature_c"].to_numpy(np.float64)[shown], ".", ms=2.5, color=BEFORE)
    axes.set(ylabel="temperature (°C)")


def _clock(recording: Recording) -> tuple[Floats, str]:
    """Return the time of each ping, runs one after another, and the axis label."""
    if not recording.has("time_s"):
        return np.arange(len(recording), dtype=np.float64), "ping"
    time, run = recording.ping.time, recording.run
    out, end = np.empty(len(time)), 0.0
    for number in range(int(run.max()) + 1):
        rows = run == number
        out[rows] = end + time[rows] - time[rows].min()
        end = float(out[rows].max())
    return (out / 3600.0, "time (h)") if end > 5400.0 else (out, "time (s)")


def _some(n: int) -> Ints:
    """Return the rows to draw: all, or a random sample, which unlike a stride has no bias within visits."""
    if n <= MAX_POINTS:
        return np.arange(n)
    return np.sort(np.random.default_rng(0).choice(n, MAX_POINTS, replace=False))


# file -> (function, content)
FIGURES: dict[str, tuple[Callable[[Recording], bytes], str]] = {
    "credence-polar.png": (credence_polar, "credence over bearing and distance (thesis, figure 4.1)"),
    "credence-plane.png": (credence_plane, "credence in the plane, from above (thesis, figure 4.2)"),
    "detection.png": (detection, "share of pings with an echo"),
    "readings.png": (readings, "readings against true distances"),
    "course.png": (course, "errors and temperature over time"),
}
