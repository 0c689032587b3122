"""The image of SonarParking-v0: street, car, cones by credence, readings and truth, and a panel of numbers."""

from __future__ import annotations

import numpy as np
import pygame
from numpy.typing import NDArray

from sonar_gym.parking import drawing
from sonar_gym.parking.drawing import Brush, Camera, Point
from sonar_gym.parking.world import WorldView
from sonar_gym.sensing.mounts import in_world, mount_arrays

WIDTH, HEIGHT = 1000, 660  # px
HEADER, FOOTER = 54, 176  # px; height above and below the view
VIEW_M = 3.6  # m; length of street in the view
MAP_HEIGHT = 22.0  # px; height of the overview of the whole street
DETAIL = 2  # drawn twice as large and scaled down, for antialiasing
WHEEL = (0.075, 0.032)  # m
NO_ECHO_CONE = 0.35  # m; length at which a cone without an echo is drawn
BAR_SPAN = 1.5  # m; range at the end of a bar in the panel
UNLABELLED_CAUSES = ("target", "empty", "no answer")  # causes that are not labelled


class Renderer:
    """Draws a world.

    Args:
        mode: "rgb_array" returns images, "human" shows them in a window.
        fps: images per second in the window.
    """

    def __init__(self, mode: str, fps: int) -> None:
        self.mode = mode
        self.fps = fps
        self._canvas = pygame.Surface((WIDTH * DETAIL, HEIGHT * DETAIL))
        self._brush = Brush(self._canvas, DETAIL)
        self._trail: list[Point] = []
        self._window: pygame.Surface | None = None
        self._clock = pygame.time.Clock()

    def draw(self, world: WorldView) -> NDArray[np.uint8] | None:
        """Draw the current state of a world."""
        self._extend_trail(world)
        camera = _camera(world)
        self._canvas.fill(drawing.PAPER)
        self._canvas.set_clip(pygame.Rect(0, HEADER * DETAIL, WIDTH * DETAIL, (HEIGHT - HEADER - FOOTER) * DETAIL))
        _street(self._brush, camera, world)
        _trail(self._brush, camera, self._trail)
        _cones(self._brush, camera, world)
        _car(self._brush, camera, world)
        _readings(self._brush, camera, world)
        self._canvas.set_clip(None)
        _header(self._brush, world)
        _footer(self._brush, world, camera)
        image = pygame.transform.smoothscale(self._canvas, (WIDTH, HEIGHT))
        if self.mode == "human":
            self._show_window(image)
            return None
        return _pixels(image)

    def _extend_trail(self, world: WorldView) -> None:
        if world.steps == 0:
            self._trail.clear()
        self._trail.append((float(world.car.state[0]), float(world.car.state[1])))

    def _show_window(self, image: pygame.Surface) -> None:
        if self._window is None:
            pygame.display.init()
            pygame.display.set_caption("SonarParking-v0")
            self._window = pygame.display.set_mode((WIDTH, HEIGHT))
        self._window.blit(image, (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self.fps)

    def close(self) -> None:
        """Close the window, if it is open."""
        if self._window is not None:
            pygame.display.quit()
            self._window = None


def _pixels(image: pygame.Surface) -> NDArray[np.uint8]:
    return np.ascontiguousarray(pygame.surfarray.array3d(image).swapaxes(0, 1), dtype=np.uint8)


def _camera(world: WorldView) -> Camera:
    """Return a camera that follows the car, with more of the street before it than behind it."""
    scale = WIDTH / VIEW_M
    left = float(np.clip(world.car.state[0] - 0.42 * VIEW_M, -0.9, world.street.end + 0.15 - VIEW_M))
    middle = 0.5 * (world.street.kerb + world.street.settings.far_side)
    top = middle + 0.5 * (HEIGHT - HEADER - FOOTER) / scale
    return Camera(left, top, scale, 0.0, HEADER)


# ---- the street ------------------------------------------------------------------------------------------------------


def _area(camera: Camera, x1: float, y1: float, x2: float, y2: float) -> list[Point]:
    return camera.pixels([(x1, y1), (x2, y1), (x2, y2), (x1, y2)])


def _street(brush: Brush, camera: Camera, world: WorldView) -> None:
    street = world.street
    begin, end, far = -3.0, street.end, street.settings.far_side
    brush.polygon(_area(camera, begin, -9.0, end + 9.0, 9.0), drawing.PAVEMENT)
    brush.polygon(_area(camera, begin, street.kerb, end, far), drawing.ASPHALT)
    brush.polygon(_area(camera, begin, street.kerb, end, street.line), drawing.STRIP)
    _markings(brush, camera, world)
    _gap(brush, camera, world)
    for box in (*street.boxes, *world.obstacles):
        outline = camera.pixels(box.corners)
        colour = drawing.blend(drawing.DARK_BOX, drawing.LIGHT_BOX, box.reflectance)
        brush.polygon([(x + 3, y + 4) for x, y in outline], drawing.INK, 60)
        brush.polygon(outline, colour)
        brush.line(outline, drawing.blend(colour, drawing.INK, 0.45), 1.5, closed=True)
        brush.text(f"{box.reflectance:.1f}", camera.pixel((box.x, box.y)), 13, _text_colour(colour), at="c")


def _text_colour(colour: drawing.Colour) -> drawing.Colour:
    """Return a legible text colour for a background colour."""
    return drawing.INK if sum(colour) > 380 else drawing.PAPER


def _markings(brush: Brush, camera: Camera, world: WorldView) -> None:
    street = world.street
    middle = 0.5 * (street.settings.far_side + street.line)
    for y in (street.kerb, street.settings.far_side):
        brush.line(camera.pixels([(-3.0, y), (street.end, y)]), drawing.blend(drawing.PAVEMENT, drawing.INK, 0.35), 4)
    brush.line(camera.pixels([(-3.0, street.line), (street.end, street.line)]), drawing.MARKING, 1.5)
    ends = camera.pixels([(-3.0, middle), (street.end, middle)])
    brush.dashes(ends[0], ends[1], drawing.MARKING, 0.16 * camera.scale, 0.12 * camera.scale, 2.5)


def _gap(brush: Brush, camera: Camera, world: WorldView) -> None:
    (begin, end), street = world.street.gap, world.street
    outline = _area(camera, begin, street.kerb, end, street.line)
    brush.polygon(outline, drawing.SPACE, 70)
    brush.line(outline, drawing.SPACE, 2.0, closed=True)
    brush.text("P", camera.pixel((0.5 * (begin + end), 0.5 * (street.kerb + street.line))), 34, drawing.SPACE, "c")


def _trail(brush: Brush, camera: Camera, trail: list[Point]) -> None:
    for point in trail[:-1:2]:
        brush.disc(camera.pixel(point), 1.7, drawing.blend(drawing.ASPHALT, drawing.CAR, 0.75))


# ---- the car ---------------------------------------------------------------------------------------------------------


def _rectangle(pose: NDArray[np.float64], x: float, y: float, length: float, width: float, turn: float = 0.0) -> list:
    """Return the corners of a rectangle about (x, y) in the frame of a pose."""
    c, s = np.cos(turn), np.sin(turn)
    local = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [0.5 * length, 0.5 * width] @ np.array([[c, s], [-s, c]])
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return list((local + np.array([x, y])) @ np.array([[c, s], [-s, c]]) + pose[:2])


def _car(brush: Brush, camera: Camera, world: WorldView) -> None:
    car, s = world.car, world.car_settings
    body = _rectangle(car.pose, s.centre, 0.0, s.length, s.width)
    brush.polygon([(x + 4, y + 5) for x, y in camera.pixels(body)], drawing.INK, 70)
    half = 0.5 * s.width - 0.006
    for x, turn in ((0.0, 0.0), (s.wheelbase, car.steering)):
        for y in (-half, half):
            brush.polygon(camera.pixels(_rectangle(car.pose, x, y, *WHEEL, turn)), drawing.TYRE)
    colour = drawing.BAD if world.collision else drawing.CAR
    inner = _rectangle(car.pose, s.centre, 0.0, s.length, s.width - 0.03)
    brush.polygon(camera.pixels(inner), colour)
    brush.line(camera.pixels(body), drawing.blend(colour, drawing.INK, 0.35), 1.0, closed=True)
    _windows(brush, camera, world)


def _windows(brush: Brush, camera: Camera, world: WorldView) -> None:
    pose, s = world.car.pose, world.car_settings
    brush.polygon(camera.pixels(_rectangle(pose, s.centre - 0.02, 0.0, 0.44 * s.length, 0.62 * s.width)), drawing.GLASS)
    roof = drawing.blend(drawing.BAD if world.collision else drawing.CAR, drawing.PAPER, 0.2)
    brush.polygon(camera.pixels(_rectangle(pose, s.centre - 0.03, 0.0, 0.25 * s.length, 0.56 * s.width)), roof)
    front = s.length - s.rear_overhang
    for y in (-0.3, 0.3):
        lamp = _rectangle(pose, front - 0.012, y * s.width, 0.02, 0.035)
        brush.polygon(camera.pixels(lamp), (255, 240, 190))
        tail = _rectangle(pose, 0.012 - s.rear_overhang, y * s.width, 0.016, 0.035)
        brush.polygon(camera.pixels(tail), drawing.BAD)


# ---- the sonars ------------------------------------------------------------------------------------------------------


def _cones(brush: Brush, camera: Camera, world: WorldView) -> None:
    poses, (_, half) = world.mount_poses, mount_arrays(world.mounts)
    poses, readings = in_world(poses, world.car.pose), world.readings
    for i, pose in enumerate(poses):
        echo = bool(readings.reading.echo[i])
        radius = readings.reading.range[i] if echo else NO_ECHO_CONE
        outline = camera.pixels(drawing.wedge((pose[0], pose[1]), pose[2], half[i], radius))
        colour = drawing.credence_colour(readings.credence[i]) if echo else drawing.PAPER
        brush.polygon(outline, colour, 72 if echo else 26)
        if echo:
            brush.line(outline[1:], colour, 2.5)


def _readings(brush: Brush, camera: Camera, world: WorldView) -> None:
    """Draw a ring at the reading, along the true bearing, and a dot at the true point."""
    poses = world.mount_poses
    poses, readings, hits = in_world(poses, world.car.pose), world.readings, world.hits
    for i, pose in enumerate(poses):
        along = pose[2] + hits.bearing[i]
        measured = camera.pixel(pose[:2] + readings.reading.range[i] * np.array([np.cos(along), np.sin(along)]))
        true, colour = camera.pixel(hits.point[i]), drawing.credence_colour(readings.credence[i])
        echo, in_cone = bool(readings.reading.echo[i]), bool(hits.in_cone[i])
        if echo and in_cone:
            brush.line([measured, true], colour, 1.0)  # the error
        if in_cone:
            brush.disc(true, 4.0, drawing.INK)
            brush.disc(true, 2.8, drawing.TRUTH)
        if echo:
            brush.ring(measured, 7.5, drawing.INK, 3.5)
            brush.ring(measured, 7.0, colour, 2.5)
        if echo and not in_cone:
            _cross(brush, measured, colour)


def _cross(brush: Brush, pixel: Point, colour: drawing.Colour) -> None:
    """Draw a cross over a ghost: an echo of an empty cone."""
    for stroke, width in ((drawing.INK, 3.5), (colour, 2.5)):
        for turn in (1, -1):
            brush.line([(pixel[0] - 5, pixel[1] - 5 * turn), (pixel[0] + 5, pixel[1] + 5 * turn)], stroke, width)


# ---- text and numbers ------------------------------------------------------------------------------------------------


def _status(world: WorldView) -> tuple[str, drawing.Colour]:
    if world.parked:
        return "parked", drawing.GOOD
    if world.collision:
        return "collision", drawing.BAD
    return ("left the street", drawing.BAD) if world.left_street else ("driving", drawing.CAR)


def _header(brush: Brush, world: WorldView) -> None:
    middle = 0.5 * HEADER
    brush.text("SonarParking", (20, middle), 24)
    brush.text(f"sonar: {world.sonar_name}", (232, middle), 18, drawing.FAINT)
    brush.text(f"{world.car.speed:+.2f} m/s", (WIDTH - 250, middle), 18, at="e")
    brush.text(f"{world.steps * 0.1:.1f} s", (WIDTH - 165, middle), 18, at="e")
    text, colour = _status(world)
    brush.panel(WIDTH - 150, middle - 15, 130, 30, colour, 15)
    brush.text(text, (WIDTH - 85, middle), 17, drawing.PAPER, "c")


def _footer(brush: Brush, world: WorldView, camera: Camera) -> None:
    top = HEIGHT - FOOTER
    _overview(brush, world, camera, top + 14)
    _bars(brush, world, top + 52)
    _legend(brush, top + 52)


def _overview(brush: Brush, world: WorldView, camera: Camera, top: float) -> None:
    street = world.street
    begin, length = -1.0, street.end + 1.0
    overview = Camera(begin, street.line, (WIDTH - 40) / length, 20, top)
    height_scale = MAP_HEIGHT / (street.settings.depth * overview.scale)

    def span(x1: float, x2: float) -> tuple[float, float]:
        return overview.pixel((x1, 0.0))[0], (x2 - x1) * overview.scale

    brush.panel(20, top, WIDTH - 40, MAP_HEIGHT, drawing.HAIRLINE, 4)
    x, width = span(*street.gap)
    brush.panel(x, top, width, MAP_HEIGHT, drawing.SPACE)
    for box in street.boxes:
        x, width = span(box.x - 0.5 * box.length, box.x + 0.5 * box.length)
        brush.panel(x, top, width, MAP_HEIGHT, drawing.blend(drawing.DARK_BOX, drawing.LIGHT_BOX, box.reflectance), 2)
    left, right = max(camera.left, begin), min(camera.left + VIEW_M, street.end)
    x, width = span(left, right)
    brush.line([(x, top - 3), (x + width, top - 3)], drawing.FAINT, 2)
    rear = world.car.state[0] - world.car_settings.rear_overhang
    x, width = span(rear, rear + world.car_settings.length)
    brush.panel(x, top + 0.5 * MAP_HEIGHT - 4 * min(height_scale, 1.0), width, 8, drawing.CAR, 4)


def _bars(brush: Brush, world: WorldView, top: float) -> None:
    rows = -(-len(world.mounts) // 2)
    pitch = min(28.0, 112.0 / rows)
    for i, mount in enumerate(world.mounts):
        _bar(brush, world, i, mount.name, 20 + 340 * (i // rows), top + pitch * (i % rows + 0.5))


def _bar(brush: Brush, world: WorldView, i: int, name: str, x: float, y: float) -> None:
    readings, hits, start, span = world.readings, world.hits, x + 80, 100.0
    brush.text(name, (x, y), 14)
    brush.panel(start, y - 5, span, 10, drawing.HAIRLINE, 5)
    if readings.reading.echo[i]:
        share = min(readings.reading.range[i] / BAR_SPAN, 1.0)
        brush.panel(start, y - 5, max(share * span, 6), 10, drawing.credence_colour(readings.credence[i]), 5)
        brush.text(f"{readings.reading.range[i]:.2f} m", (start + span + 6, y), 14)
    else:
        answered = bool(readings.reading.answered[i])
        brush.text("no echo" if answered else "no answer", (start + span + 6, y), 14, drawing.FAINT)
    if hits.in_cone[i]:
        at = start + min(hits.distance[i] / BAR_SPAN, 1.0) * span
        brush.line([(at, y - 8), (at, y + 8)], drawing.INK, 2)
    if world.causes[i] not in UNLABELLED_CAUSES:
        brush.text(world.causes[i], (start + span + 66, y), 14, drawing.BAD)


def _legend(brush: Brush, top: float) -> None:
    x = 712.0
    brush.text("credence of a reading", (x, top + 8), 14)
    for k in range(100):
        brush.panel(x + 1.6 * k, top + 20, 2.0, 10, drawing.credence_colour(k / 99))
    for share in (0.0, 0.5, 1.0):
        brush.text(f"{share:g}", (x + 160 * share, top + 40), 13, drawing.FAINT, at="c")
    brush.ring((x + 8, top + 56), 7.0, drawing.CREDENCE[2], 2.5)
    brush.text("reading (bar below, ring above)", (x + 24, top + 56), 14)
    brush.disc((x + 8, top + 73), 4.0, drawing.INK)
    brush.disc((x + 8, top + 73), 2.8, drawing.TRUTH)
    brush.text("truth (tick below, dot above)", (x + 24, top + 73), 14)
    brush.ring((x + 8, top + 90), 7.0, drawing.CREDENCE[0], 2.5)
    _cross(brush, (x + 8, top + 90), drawing.CREDENCE[0])
    brush.text("ghost: nothing is there", (x + 24, top + 90), 14)
    brush.polygon([(x + 190, top + 97), (x + 184, top + 84), (x + 196, top + 84)], drawing.FAINT)
    brush.text("no echo", (x + 204, top + 90), 14)
    brush.panel(x, top + 100, 8, 14, drawing.DARK_BOX)
    brush.panel(x + 8, top + 100, 8, 14, drawing.LIGHT_BOX)
    brush.text("boxes by reflectance", (x + 24, top + 107), 14)
