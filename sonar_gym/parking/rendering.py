"""The picture of SonarParking-v0: street, car, cones by credence, readings against truth, and a panel of numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pygame
from numpy.typing import NDArray

from sonar_gym.parking import drawing as paint
from sonar_gym.parking.drawing import Brush, Camera, Place
from sonar_gym.sensing.mounts import in_world, mount_arrays

if TYPE_CHECKING:
    from sonar_gym.parking.world import World

WIDTH, HEIGHT = 1000, 660  # px
HEAD, FOOT = 54, 176  # px above and below the view
VIEW_M = 3.6  # m of street in the view
MAP_HEIGHT = 22.0  # px, of the little map of the whole street
DETAIL = 2  # drawn twice as large and reduced, which smooths edges
WHEEL = (0.075, 0.032)  # m
SILENT_CONE = 0.35  # m; how far an empty cone is drawn
BAR_SPAN = 1.5  # m at the end of a bar in the panel
UNTOLD = ("target", "empty", "no answer")  # causes that go without saying


class Renderer:
    """Draws an environment.

    Args:
        mode: "rgb_array" returns pictures, "human" shows them in a window.
        fps: pictures a second in the window.
    """

    def __init__(self, mode: str, fps: int) -> None:
        self.mode = mode
        self.fps = fps
        self._canvas = pygame.Surface((WIDTH * DETAIL, HEIGHT * DETAIL))
        self._brush = Brush(self._canvas, DETAIL)
        self._trail: list[Place] = []
        self._window: pygame.Surface | None = None
        self._clock = pygame.time.Clock()

    def draw(self, env: World) -> NDArray[np.uint8] | None:
        """Draw a world as it is now."""
        self._remember(env)
        camera = _camera(env)
        self._canvas.fill(paint.PAPER)
        self._canvas.set_clip(pygame.Rect(0, HEAD * DETAIL, WIDTH * DETAIL, (HEIGHT - HEAD - FOOT) * DETAIL))
        _street(self._brush, camera, env)
        _trail(self._brush, camera, self._trail)
        _cones(self._brush, camera, env)
        _car(self._brush, camera, env)
        _readings(self._brush, camera, env)
        self._canvas.set_clip(None)
        _head(self._brush, env)
        _foot(self._brush, env, camera)
        picture = pygame.transform.smoothscale(self._canvas, (WIDTH, HEIGHT))
        if self.mode == "human":
            self._show(picture)
            return None
        return _pixels(picture)

    def _remember(self, env: World) -> None:
        if env.steps == 0:
            self._trail.clear()
        self._trail.append((float(env.car.state[0]), float(env.car.state[1])))

    def _show(self, picture: pygame.Surface) -> None:
        if self._window is None:
            pygame.display.init()
            pygame.display.set_caption("SonarParking-v0")
            self._window = pygame.display.set_mode((WIDTH, HEIGHT))
        self._window.blit(picture, (0, 0))
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self.fps)

    def close(self) -> None:
        """Close the window; again is harmless."""
        if self._window is not None:
            pygame.display.quit()
            self._window = None


def _pixels(picture: pygame.Surface) -> NDArray[np.uint8]:
    return np.ascontiguousarray(pygame.surfarray.array3d(picture).swapaxes(0, 1), dtype=np.uint8)


def _camera(env: World) -> Camera:
    """Follow the car, with more of the street before it than behind it."""
    scale = WIDTH / VIEW_M
    left = float(np.clip(env.car.state[0] - 0.42 * VIEW_M, -0.9, env.street.end + 0.15 - VIEW_M))
    middle = 0.5 * (env.street.kerb + env.street.settings.far_side)
    top = middle + 0.5 * (HEIGHT - HEAD - FOOT) / scale
    return Camera(left, top, scale, 0.0, HEAD)


# ---- the street ------------------------------------------------------------------------------------------------------


def _area(camera: Camera, x1: float, y1: float, x2: float, y2: float) -> list[Place]:
    return camera.places([(x1, y1), (x2, y1), (x2, y2), (x1, y2)])


def _street(brush: Brush, camera: Camera, env: World) -> None:
    street = env.street
    begin, end, far = -3.0, street.end, street.settings.far_side
    brush.polygon(_area(camera, begin, -9.0, end + 9.0, 9.0), paint.PAVEMENT)
    brush.polygon(_area(camera, begin, street.kerb, end, far), paint.ASPHALT)
    brush.polygon(_area(camera, begin, street.kerb, end, street.line), paint.STRIP)
    _markings(brush, camera, env)
    _space(brush, camera, env)
    for box in street.boxes:
        outline = camera.places(box.corners)
        colour = paint.blend(paint.DARK_BOX, paint.LIGHT_BOX, box.reflectance)
        brush.polygon([(x + 3, y + 4) for x, y in outline], paint.INK, 60)
        brush.polygon(outline, colour)
        brush.line(outline, paint.blend(colour, paint.INK, 0.45), 1.5, closed=True)
        brush.text(f"{box.reflectance:.1f}", camera.place((box.x, box.y)), 13, _on(colour), at="c")


def _on(colour: paint.Colour) -> paint.Colour:
    """Return the colour of words that can be read on a colour."""
    return paint.INK if sum(colour) > 380 else paint.PAPER


def _markings(brush: Brush, camera: Camera, env: World) -> None:
    street = env.street
    middle = 0.5 * (street.settings.far_side + street.line)
    for y in (street.kerb, street.settings.far_side):
        brush.line(camera.places([(-3.0, y), (street.end, y)]), paint.blend(paint.PAVEMENT, paint.INK, 0.35), 4)
    brush.line(camera.places([(-3.0, street.line), (street.end, street.line)]), paint.MARKING, 1.5)
    ends = camera.places([(-3.0, middle), (street.end, middle)])
    brush.dashes(ends[0], ends[1], paint.MARKING, 0.16 * camera.scale, 0.12 * camera.scale, 2.5)


def _space(brush: Brush, camera: Camera, env: World) -> None:
    (begin, end), street = env.street.gap, env.street
    outline = _area(camera, begin, street.kerb, end, street.line)
    brush.polygon(outline, paint.SPACE, 70)
    brush.line(outline, paint.SPACE, 2.0, closed=True)
    brush.text("P", camera.place((0.5 * (begin + end), 0.5 * (street.kerb + street.line))), 34, paint.SPACE, "c")


def _trail(brush: Brush, camera: Camera, trail: list[Place]) -> None:
    for point in trail[:-1:2]:
        brush.disc(camera.place(point), 1.7, paint.blend(paint.ASPHALT, paint.CAR, 0.75))


# ---- the car ---------------------------------------------------------------------------------------------------------


def _rectangle(pose: NDArray[np.float64], x: float, y: float, length: float, width: float, turn: float = 0.0) -> list:
    """Return the corners of a rectangle about (x, y) in a pose's frame."""
    c, s = np.cos(turn), np.sin(turn)
    local = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [0.5 * length, 0.5 * width] @ np.array([[c, s], [-s, c]])
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return list((local + np.array([x, y])) @ np.array([[c, s], [-s, c]]) + pose[:2])


def _car(brush: Brush, camera: Camera, env: World) -> None:
    car, s = env.car, env.car_settings
    body = _rectangle(car.pose, s.centre, 0.0, s.length, s.width)
    brush.polygon([(x + 4, y + 5) for x, y in camera.places(body)], paint.INK, 70)
    half = 0.5 * s.width - 0.006
    for x, turn in ((0.0, 0.0), (s.wheelbase, car.steering)):
        for y in (-half, half):
            brush.polygon(camera.places(_rectangle(car.pose, x, y, *WHEEL, turn)), paint.TYRE)
    colour = paint.BAD if env.collision else paint.CAR
    inner = _rectangle(car.pose, s.centre, 0.0, s.length, s.width - 0.03)
    brush.polygon(camera.places(inner), colour)
    brush.line(camera.places(body), paint.blend(colour, paint.INK, 0.35), 1.0, closed=True)
    _windows(brush, camera, env)


def _windows(brush: Brush, camera: Camera, env: World) -> None:
    pose, s = env.car.pose, env.car_settings
    brush.polygon(camera.places(_rectangle(pose, s.centre - 0.02, 0.0, 0.44 * s.length, 0.62 * s.width)), paint.GLASS)
    roof = paint.blend(paint.BAD if env.collision else paint.CAR, paint.PAPER, 0.2)
    brush.polygon(camera.places(_rectangle(pose, s.centre - 0.03, 0.0, 0.25 * s.length, 0.56 * s.width)), roof)
    front = s.length - s.rear_overhang
    for y in (-0.3, 0.3):
        lamp = _rectangle(pose, front - 0.012, y * s.width, 0.02, 0.035)
        brush.polygon(camera.places(lamp), (255, 240, 190))
        tail = _rectangle(pose, 0.012 - s.rear_overhang, y * s.width, 0.016, 0.035)
        brush.polygon(camera.places(tail), paint.BAD)


# ---- the sonars ------------------------------------------------------------------------------------------------------


def _cones(brush: Brush, camera: Camera, env: World) -> None:
    poses, half = mount_arrays(env.mounts)
    poses, heard = in_world(poses, env.car.pose), env.heard
    for i, pose in enumerate(poses):
        echo = bool(heard.reading.echo[i])
        reach = heard.reading.range[i] if echo else SILENT_CONE
        outline = camera.places(paint.wedge((pose[0], pose[1]), pose[2], half[i], reach))
        colour = paint.credence_colour(heard.credence[i]) if echo else paint.PAPER
        brush.polygon(outline, colour, 72 if echo else 26)
        if echo:
            brush.line(outline[1:], colour, 2.5)


def _readings(brush: Brush, camera: Camera, env: World) -> None:
    """Put a ring where the reading says the reflector is, along the true bearing, and a dot where it truly is."""
    poses, _ = mount_arrays(env.mounts)
    poses, heard, hits = in_world(poses, env.car.pose), env.heard, env.hits
    for i, pose in enumerate(poses):
        along = pose[2] + hits.bearing[i]
        said = camera.place(pose[:2] + heard.reading.range[i] * np.array([np.cos(along), np.sin(along)]))
        true, colour = camera.place(hits.point[i]), paint.credence_colour(heard.credence[i])
        echo, seen = bool(heard.reading.echo[i]), bool(hits.seen[i])
        if echo and seen:
            brush.line([said, true], colour, 1.0)  # the error
        if seen:
            brush.disc(true, 4.0, paint.INK)
            brush.disc(true, 2.8, paint.TRUTH)
        if echo:
            brush.ring(said, 7.5, paint.INK, 3.5)
            brush.ring(said, 7.0, colour, 2.5)
        if echo and not seen:
            _cross(brush, said, colour)


def _cross(brush: Brush, place: Place, colour: paint.Colour) -> None:
    """Strike out a ghost: a reading of what is not there."""
    for ink, width in ((paint.INK, 3.5), (colour, 2.5)):
        for turn in (1, -1):
            brush.line([(place[0] - 5, place[1] - 5 * turn), (place[0] + 5, place[1] + 5 * turn)], ink, width)


# ---- words and numbers -----------------------------------------------------------------------------------------------


def _status(env: World) -> tuple[str, paint.Colour]:
    if env.parked:
        return "parked", paint.GOOD
    if env.collision:
        return "collision", paint.BAD
    return ("left the street", paint.BAD) if env.left_street else ("driving", paint.CAR)


def _head(brush: Brush, env: World) -> None:
    middle = 0.5 * HEAD
    brush.text("SonarParking", (20, middle), 24)
    brush.text(f"sonar: {env.sonar_name}", (232, middle), 18, paint.FAINT)
    brush.text(f"{env.car.speed:+.2f} m/s", (WIDTH - 250, middle), 18, at="e")
    brush.text(f"{env.steps * 0.1:.1f} s", (WIDTH - 165, middle), 18, at="e")
    words, colour = _status(env)
    brush.panel(WIDTH - 150, middle - 15, 130, 30, colour, 15)
    brush.text(words, (WIDTH - 85, middle), 17, paint.PAPER, "c")


def _foot(brush: Brush, env: World, camera: Camera) -> None:
    top = HEIGHT - FOOT
    _map(brush, env, camera, top + 14)
    _bars(brush, env, top + 52)
    _legend(brush, top + 52)


def _map(brush: Brush, env: World, camera: Camera, top: float) -> None:
    street = env.street
    begin, length = -1.0, street.end + 1.0
    small = Camera(begin, street.line, (WIDTH - 40) / length, 20, top)
    tall = MAP_HEIGHT / (street.settings.depth * small.scale)

    def span(x1: float, x2: float) -> tuple[float, float]:
        return small.place((x1, 0.0))[0], (x2 - x1) * small.scale

    brush.panel(20, top, WIDTH - 40, MAP_HEIGHT, paint.HAIRLINE, 4)
    x, width = span(*street.gap)
    brush.panel(x, top, width, MAP_HEIGHT, paint.SPACE)
    for box in street.boxes:
        x, width = span(box.x - 0.5 * box.length, box.x + 0.5 * box.length)
        brush.panel(x, top, width, MAP_HEIGHT, paint.blend(paint.DARK_BOX, paint.LIGHT_BOX, box.reflectance), 2)
    left, right = max(camera.left, begin), min(camera.left + VIEW_M, street.end)
    x, width = span(left, right)
    brush.line([(x, top - 3), (x + width, top - 3)], paint.FAINT, 2)
    x, width = span(env.car.state[0] - env.car_settings.rear_overhang, env.car.state[0] + 0.36)
    brush.panel(x, top + 0.5 * MAP_HEIGHT - 4 * min(tall, 1.0), width, 8, paint.CAR, 4)


def _bars(brush: Brush, env: World, top: float) -> None:
    rows = -(-len(env.mounts) // 2)
    pitch = min(28.0, 112.0 / rows)
    for i, mount in enumerate(env.mounts):
        _bar(brush, env, i, mount.name, 20 + 340 * (i // rows), top + pitch * (i % rows + 0.5))


def _bar(brush: Brush, env: World, i: int, name: str, x: float, y: float) -> None:
    heard, hits, start, span = env.heard, env.hits, x + 88, 120.0
    brush.text(name, (x, y), 14)
    brush.panel(start, y - 5, span, 10, paint.HAIRLINE, 5)
    if heard.reading.echo[i]:
        share = min(heard.reading.range[i] / BAR_SPAN, 1.0)
        brush.panel(start, y - 5, max(share * span, 6), 10, paint.credence_colour(heard.credence[i]), 5)
        brush.text(f"{heard.reading.range[i]:.2f} m", (start + span + 8, y), 14)
    else:
        answered = bool(heard.reading.answered[i])
        brush.text("no echo" if answered else "no answer", (start + span + 8, y), 14, paint.FAINT)
    if hits.seen[i]:
        at = start + min(hits.distance[i] / BAR_SPAN, 1.0) * span
        brush.line([(at, y - 8), (at, y + 8)], paint.INK, 2)
    if env.causes[i] not in UNTOLD:
        brush.text(env.causes[i], (start + span + 68, y), 14, paint.BAD)


def _legend(brush: Brush, top: float) -> None:
    x = 712.0
    brush.text("credence of a reading", (x, top + 8), 14)
    for k in range(100):
        brush.panel(x + 1.6 * k, top + 20, 2.0, 10, paint.credence_colour(k / 99))
    for share in (0.0, 0.5, 1.0):
        brush.text(f"{share:g}", (x + 160 * share, top + 40), 13, paint.FAINT, at="c")
    brush.ring((x + 8, top + 56), 7.0, paint.CREDENCE[2], 2.5)
    brush.text("reading (bar below, ring above)", (x + 24, top + 56), 14)
    brush.disc((x + 8, top + 73), 4.0, paint.INK)
    brush.disc((x + 8, top + 73), 2.8, paint.TRUTH)
    brush.text("truth (tick below, dot above)", (x + 24, top + 73), 14)
    brush.ring((x + 8, top + 90), 7.0, paint.CREDENCE[0], 2.5)
    _cross(brush, (x + 8, top + 90), paint.CREDENCE[0])
    brush.text("ghost: nothing is there", (x + 24, top + 90), 14)
    brush.polygon([(x + 190, top + 97), (x + 184, top + 84), (x + 196, top + 84)], paint.FAINT)
    brush.text("no echo", (x + 204, top + 90), 14)
    brush.panel(x, top + 100, 8, 14, paint.DARK_BOX)
    brush.panel(x + 8, top + 100, 8, 14, paint.LIGHT_BOX)
    brush.text("boxes by reflectance", (x + 24, top + 107), 14)
