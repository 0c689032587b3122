"""Target effects: losses of the direct echo, and additional paths by the reflector and its surroundings.

An additional path has a `presence`, the probability that it exists, with null 0. Since the first echo is reported, a
path longer than the direct one is observed only if the direct echo is missed.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from noise.effects.base import EchoSample, Effect, Parameter, Stage, modes, most_frequent
from noise.effects.state import Later, State, heard_level_db, new_path, number, wall_level_db

WAVELENGTH = 8.584e-3  # m; 40 kHz at 19 degC and 50 % relative humidity
MAX_BEHIND_M = 2.0  # of an object behind the reflector; chosen here
MIN_SCATTER_M = 0.002  # of the readings of another object, where a fit begins; chosen here
NEAR = 0.02  # m; lower limit of the distance in the asymptotic formulas below


def presence(start: float = 0.5) -> Parameter:
    """Return the parameter common to all additional paths."""
    return Parameter("presence", "1", 0.0, 0.0, 1.0, "probability; chosen here", (start,))


def missed() -> Parameter:
    """Return the parameter for loud first echoes that a receiver misses, so that it reads a later one."""
    return Parameter("missed", "1", 0.0, 0.0, 0.5, "share of loud first echoes; chosen here", (0.1, 0.0))


def half_width(null: float = 0.1) -> Parameter:
    """Return the parameter for half the width of a reflector; 0.1 m is the radius of the thesis's disc."""
    return Parameter("half_width_m", "m", null, 0.02, 2.0, "disc of Esmi (2016): radius 0.1 m", (null,))


def miss(state: State, half_width_m: Tensor) -> Tensor:
    """Return the distance of the foot of the perpendicular beyond the face, as Fresnel parameter v, (n,).

    The edge is a knife edge midway to the mirror image (ITU-R P.526): v = m sqrt(2 / lambda (1/d + 1/d)),
    m = d sin t - a.
    """
    c = state.conditions
    d = torch.clamp(c.distance, min=NEAR)
    return 2.0 * (d * torch.sin(c.incidence).abs() - half_width_m) / torch.sqrt(WAVELENGTH * d)


class ReflectanceLoss(Effect):
    """The amplitude is proportional to a power of the logged reflectance: level -> level + strength 20 log10 R."""

    name = "reflectance_loss"
    stage = Stage.PATHS
    summary = "Reflectors of low reflectance send weaker echoes"
    parameters = (
        Parameter(
            "strength", "1", 0.0, 0.0, 2.0, "1 = amplitude in proportion to reflectance; chosen here", (1.0,), adds=True
        ),
    )
    strength: Tensor

    def apply(self, state: State) -> State:
        """Attenuate the direct path."""
        loss_db = 20.0 * torch.log10(torch.clamp(state.conditions.reflectance, min=1e-3))
        return state.with_direct(replace(state.direct, level_db=state.direct.level_db + self.strength * loss_db))

    def statement(self) -> str:
        """Return a sentence with the loss at reflectance 0.1."""
        loss_db = 20.0 * self.values["strength"]
        weaker = "weaker" if loss_db >= 0.0 else "stronger"
        return f"Reflectors of low reflectance send {weaker} echoes, by {abs(loss_db):.2g} dB at reflectance 0.1."


class SpecularLoss(Effect):
    """A smooth face reflects as long as the perpendicular hits it; beyond its edge the level falls as at a knife edge.

    level -> level - strength J(v), J(v) = 6.9 + 20 log10(sqrt((v - 0.1)^2 + 1) + v - 0.1) dB for v > -0.78.
    """

    name = "specular_loss"
    stage = Stage.PATHS
    summary = "Tilted smooth reflectors deflect the sound: their echoes are weaker or lost"
    parameters = (
        Parameter("strength", "1", 0.0, 0.0, 2.0, "1 = knife edge, ITU-R P.526; other: chosen here", (1.0,)),
        half_width(),
    )
    strength: Tensor
    half_width_m: Tensor

    def apply(self, state: State) -> State:
        """Attenuate the direct path where the perpendicular misses the face."""
        v = miss(state, self.half_width_m) - 0.1
        loss_db = torch.relu(6.9 + 20.0 * torch.log10(torch.sqrt(v**2 + 1.0) + v))
        return state.with_direct(replace(state.direct, level_db=state.direct.level_db - self.strength * loss_db))

    def statement(self) -> str:
        """Return a sentence with the angle at which the loss begins at 1 m."""
        angle = math.degrees(math.asin(min(1.0, self.values["half_width_m"])))
        return (
            f"{self.summary}, at 1 m from {angle:.0f} deg on ({100 * self.values['strength']:.0f} % of a knife edge)."
        )


class EdgeDiffraction(Effect):
    """Echo of the near edge of the face: length sqrt(d^2 + a^2 - 2 d a sin t), -33 dB re a wall at 1 m (GTD)."""

    name = "edge_diffraction"
    stage = Stage.PATHS
    summary = "The near edge of the reflector gives a weak echo before that of its centre"
    parameters = (presence(), half_width())
    presence: Tensor
    half_width_m: Tensor

    def apply(self, state: State) -> State:
        """Add the path over the near edge."""
        c, a = state.conditions, self.half_width_m
        turn = torch.clamp(c.incidence.abs(), max=1.4)
        d = torch.clamp(c.distance, min=NEAR)
        length = torch.sqrt(d**2 + a**2 - 2.0 * d * a * torch.sin(turn) + 1e-12)
        amplitude = torch.sqrt(WAVELENGTH / d) * (1.0 + 1.0 / torch.cos(turn)) / (2.0 * math.sqrt(2.0) * math.pi)
        level_db = wall_level_db(d) + 20.0 * torch.log10(torch.clamp(amplitude, max=1.0))
        return state.with_path(new_path("edge", length, level_db, self.presence, c.angle))

    def statement(self) -> str:
        """Return a sentence with the path difference at 45 degrees."""
        early = self.values["half_width_m"] * math.sin(math.pi / 4)
        return f"{self.summary}, by {1000 * early:.0f} mm at 45 deg, in {_percent(self.values['presence'])} of pings."


class PerpendicularFoot(Effect):
    """A tilted face reflects at the foot of the perpendicular, at d cos t instead of the distance of its centre."""

    name = "perpendicular_foot"
    stage = Stage.PATHS
    summary = "Tilted reflectors are read at the foot of the perpendicular: short by 1 - cos(incidence)"
    parameters = (Parameter("share", "1", 0.0, 0.0, 1.0, "1 = mirror geometry", (1.0,)), half_width())
    share: Tensor
    half_width_m: Tensor

    def apply(self, state: State) -> State:
        """Shorten the direct path where the perpendicular hits the face."""
        c = state.conditions
        # lost about 1 deg beyond the edge at 1 m, as the Kirchhoff integral of a disc has it
        seen = torch.sigmoid(-6.0 * (miss(state, self.half_width_m) - 0.4))
        short = c.distance * (1.0 - torch.cos(c.incidence)) * self.share * seen
        return state.with_direct(replace(state.direct, length=state.direct.length - short))

    def statement(self) -> str:
        """Return a sentence with the shift at 5 degrees and 1 m."""
        short = self.values["share"] * (1 - math.cos(math.radians(5)))
        return f"{self.summary}, {1000 * short:.1f} mm at 5 deg and 1 m."


class BackgroundReflector(Effect):
    """An object `behind_m` behind the reflector is read where the echo of the reflector is missed.

    Its bearing is `follow` times that of the reflector: 1 for a post behind it, 0 for a wall that fills the beam.
    """

    name = "background_reflector"
    stage = Stage.PATHS
    localised = True
    summary = "An object behind the reflector is read when the echo of the reflector is missed"
    parameters = (
        presence(0.9),
        Parameter("behind_m", "m", 0.3, 0.02, MAX_BEHIND_M, "stand of Esmi (2016): 0.3 m behind", (0.1, 0.3, 0.7)),
        Parameter("loss_db", "dB", 19.0, -10.0, 45.0, "post of 15 mm at 1.3 m: 19 dB below a wall", (5.0,)),
        Parameter("follow", "1", 1.0, 0.0, 1.0, "0 for a wall, which is on axis; chosen here", (1.0, 0.0)),
    )
    presence: Tensor
    behind_m: Tensor
    loss_db: Tensor
    follow: Tensor

    def apply(self, state: State) -> State:
        """Add the path to the object."""
        length = state.conditions.distance + self.behind_m
        level_db = wall_level_db(length) - self.loss_db
        bearing = self.follow * state.conditions.angle
        return state.with_path(new_path("background", length, level_db, self.presence, bearing))

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return how far behind the target most late readings lie, as frequent as they are of targets not heard."""
        late, loud = echoes.late, {"loss_db": 5.0, "follow": 1.0}
        lengths = [group[group < MAX_BEHIND_M] for group in modes(late.range - late.distance)]
        missed = len(late.range) + echoes.silent
        return [{"presence": len(g) / missed, "behind_m": float(np.median(g)), **loud} for g in lengths if len(g)]

    def statement(self) -> str:
        """Return a sentence with the distance behind the reflector."""
        v = self.values
        return f"{self.summary}: {1000 * v['behind_m']:.0f} mm behind, {v['loss_db']:.0f} dB below a wall."


class FixedClutter(Effect):
    """Another object in the room gives an echo at `range_m`, regardless of the position of the reflector."""

    name = "fixed_clutter"
    fixed_range = "range_m"
    stage = Stage.PATHS
    localised = True
    summary = "Another object in the room is read at a fixed range"
    parameters = (
        presence(0.2),
        Parameter("range_m", "m", 3.25, 0.05, 11.0, "floor in a beam at 1.5 m height: 3.25 m", (0.5, 1.5, 3.25)),
        Parameter("spread_m", "m", 0.005, 0.001, 0.3, "chosen here", (0.02,)),
    )
    presence: Tensor
    range_m: Tensor
    spread_m: Tensor

    def apply(self, state: State) -> State:
        """Add the path to the object."""
        length = self.range_m + torch.zeros_like(state.conditions.distance)
        path = new_path("clutter", length, heard_level_db(length), self.presence)
        return state.with_path(replace(path, spread=self.spread_m))

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return where most readings away from the target lie, as frequent as they are of targets not heard before."""
        out = []
        for group in modes(echoes.off_target.range):
            range_m, spread_m = float(np.median(group)), max(float(np.std(group)), MIN_SCATTER_M)
            able = max(int((echoes.distance > range_m).sum()), len(group)) + echoes.silent
            out.append({"presence": len(group) / able, "range_m": range_m, "spread_m": spread_m})
        return out

    def statement(self) -> str:
        """Return a sentence with the range and the probability of an echo."""
        v = self.values
        share = f"it gives an echo in {_percent(v['presence'])} of pings, read where no nearer echo is detected"
        return f"{self.summary} of {v['range_m']:.2f} m: {share}."


class Multipath(Effect):
    """A path over the floor: half its length is (sqrt(d^2 + 4 h^2) + d) / 2, with one leg at atan(2 h / d).

    It is read where the direct echo is too weak; some receivers also miss a direct echo that is loud.
    """

    name = "multipath"
    stage = Stage.PATHS
    localised = True
    summary = "Echoes reflected by the floor are read when the direct echo is missed"
    parameters = (
        presence(0.9),
        Parameter("height_m", "m", 0.3, 0.02, 3.0, "of the axis over the floor; 1.5 m in Esmi (2016)", (0.2, 0.5, 1.5)),
        Parameter("loss_db", "dB", 12.0, 0.0, 45.0, "of the floor reflection re a wall; chosen here", (5.0,)),
        missed(),
    )
    presence: Tensor
    height_m: Tensor
    loss_db: Tensor
    missed: Tensor

    def apply(self, state: State) -> State:
        """Add the path over the floor, at a bearing with the mean loss of both legs, and read it for missed echoes."""
        c = state.conditions
        slant = torch.sqrt(c.distance**2 + 4.0 * self.height_m**2)
        length = 0.5 * (slant + c.distance)
        both = 0.5 * ((2.0 * self.height_m / slant) ** 2 + torch.sin(c.angle) ** 2)
        bearing = torch.asin(torch.clamp(torch.sqrt(both + 1e-12), max=0.999))
        state = state.with_direct(state.direct.missed(Later(self.missed, 1.0, length - c.distance)))
        return state.with_path(
            new_path("floor", length, wall_level_db(length) - self.loss_db, self.presence, bearing),
        )

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return the height that explains most late readings r of targets at d: h^2 = r (r - d)."""
        late = echoes.late
        if not len(late.range):
            return []
        height_m = most_frequent(np.sqrt(late.range * (late.range - late.distance)))
        weak = {"presence": 0.9, "height_m": height_m, "loss_db": 5.0, "missed": 0.0}
        return [weak, {**weak, "missed": min(0.5, len(late.range) / len(echoes.range))}]

    def statement(self) -> str:
        """Return a sentence with the height and the error at 1 m, and one with the share of loud echoes missed."""
        late = 0.5 * (math.hypot(1.0, 2 * self.values["height_m"]) - 1.0)
        echoes = f"Echoes reflected by the floor or another surface {self.values['height_m']:.2f} m beside the axis"
        words = f"{echoes} are read when the direct echo is missed, {1000 * late:.0f} mm too long at 1 m"
        share = self.values["missed"]
        return f"{words}; {_percent(share)} of loud echoes are missed." if share > 0.0 else f"{words}."


class RepeatedBounce(Effect):
    """The echo is reflected by the sensor and travels to the target again: a second echo at twice the distance.

    It is read where the first is too weak; some receivers also miss a first echo that is loud.
    """

    name = "repeated_bounce"
    stage = Stage.PATHS
    localised = True
    summary = "A second round trip of the echo is read at twice the distance when the first echo is missed"
    parameters = (
        presence(0.9),
        Parameter("loss_db", "dB", 12.0, 0.0, 45.0, "p0 / (4 d) R_face: 6 dB and face; chosen here", (6.0,)),
        missed(),
    )
    presence: Tensor
    loss_db: Tensor
    missed: Tensor

    def apply(self, state: State) -> State:
        """Add the doubled path, and let some echoes of the direct one be read after the second trip."""
        c = state.conditions
        level_db = wall_level_db(2.0 * c.distance) - self.loss_db
        state = state.with_direct(state.direct.missed(Later(self.missed, 2.0, number(0.0))))
        return state.with_path(new_path("twice", 2.0 * c.distance, level_db, self.presence, c.angle))

    def statement(self) -> str:
        """Return sentences with the loss and the probability, and with the share of loud echoes that are missed."""
        v = self.values
        said = []
        if v["presence"] > 0.0 or v["missed"] == 0.0:
            loss = f"{v['loss_db']:.0f} dB below a wall there, in {_percent(v['presence'])} of pings"
            said.append(f"{self.summary}, {loss}.")
        if v["missed"] > 0.0:
            said.append(f"{_percent(v['missed'])} of loud echoes are missed and read at twice the distance.")
        return " ".join(said)


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"
