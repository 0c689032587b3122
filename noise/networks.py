"""Learned laws: networks from conditions to mixtures over what a register reads. Numpy alone at run time.

A network reads what a ping faced and says how an echo law looks there: logistic components placed about the true
distance, some placed anywhere on the scale, one spread over all of it, and silence. Whatever the network, its last
numbers pass through one `Head`, so other architectures differ only in how they come to those numbers.

Nothing is extrapolated silently: outside the conditions it was trained on a network is asked at the nearest one that
it knows, its law is widened and mixed with ignorance, and `MixtureLaw.excess` says so.
"""

from __future__ import annotations

import math
import os
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load_file, save_file
from scipy.special import expit, log_expit, logit

from acquisition import EchoStatus, ModelError, Ping, Reading, SettingError
from noise.law import EchoLaw, Floats

WEIGHTS_FILE = "weights.safetensors"
HEADER_BYTES = 65_536  # more than a safetensors header of ours takes
FLOOR = 1e-5  # least share of each outcome: a network is never certain
# looking a member up costs more than drawing eight numbers
_NO_ECHO, _ECHO, _NO_ANSWER = (int(EchoStatus[name]) for name in ("NO_ECHO", "ECHO", "NO_ANSWER"))
UNIT_M = 0.01  # m; scale of the network's numbers for places and widths
HALF_IGNORANT = 0.25  # excess at which half of the law is ignorance
WIDENING = 10.0  # growth of every width per unit of excess
NATURAL_SPAN = {"distance": 0.1, "angle": 0.05, "incidence": 0.05, "reflectance": 0.1}  # m, rad, rad, 1


class MixtureLaw(EchoLaw):
    """Logistic components, one uniform over the scale, silence, and a steady rate of no answer.

    Attributes:
        share: probabilities of the components, the uniform, silence, given an answer, (C + 2, n).
        centre, scale: of the components, m, (C, n).
        excess: how far each condition lies outside what was learned, in widths of the learned range, (n,).
    """

    def __init__(
        self,
        distance: Floats,
        share: Floats,
        centre: Floats,
        scale: Floats,
        head: Head,
        excess: Floats,
    ) -> None:
        super().__init__(distance, head.resolution, head.max_range)
        self.share, self.centre, self.scale = share, centre, scale
        self.answer_rate = 1.0 - head.no_answer
        self.excess = excess

    @property
    def extrapolated(self) -> np.ndarray:
        """Where the law is asked outside what was learned, (n,) bool."""
        return self.excess > 0

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer): the rate in the recording, whatever the condition."""
        return np.full(len(self), 1.0 - self.answer_rate)

    def arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at an exact range <= z)."""
        z = np.asarray(z, dtype=np.float64)
        peaks = (self.share[:-2] * expit((z[..., None, :] - self.centre) / self.scale)).sum(axis=-2)
        return self.answer_rate * (peaks + self.share[-2] * self._share_of_scale(z))

    def between(self, low: Floats, high: Floats) -> Floats:
        """Return P(an echo is registered at an exact range in (low, high]), exact in the tails."""
        a, b = ((z[..., None, :] - self.centre) / self.scale for z in (low, high))
        wide = np.where(np.isinf(a) | np.isinf(b), np.inf, (high - low)[..., None, :] / self.scale)
        # s(b) - s(a) = s(b) s(-a) (1 - exp(a - b)) holds without loss wherever a and b lie
        peaks = (self.share[:-2] * np.exp(log_expit(b) + log_expit(-a)) * -np.expm1(-wide)).sum(axis=-2)
        return self.answer_rate * (peaks + self.share[-2] * (self._share_of_scale(high) - self._share_of_scale(low)))

    def _share_of_scale(self, z: Floats) -> Floats:
        return np.clip(z / self.max_range, 0.0, 1.0)

    def sample(self, rng: np.random.Generator) -> Reading:
        """Draw a reading for each ping: one number picks the outcome, one the place within it."""
        which, where = rng.random((2, len(self)))
        edges = self.answer_rate * self.share.cumsum(axis=0)
        edges[-1] = self.answer_rate  # whatever the shares' sum is rounded to
        outcome = (which >= edges).sum(axis=0)  # C: the uniform, C + 1: silence, C + 2: no answer
        peak, column = np.minimum(outcome, len(self.centre) - 1), np.arange(len(self))
        from_peak = self.centre[peak, column] + self.scale[peak, column] * logit(where)
        place = np.where(outcome < len(self.centre), from_peak, where * self.max_range)
        step = _within(np.rint(place / self.resolution), 1, self.last_step)
        return Reading(np.where(outcome <= len(self.centre), step * self.resolution, 0.0), self._status[outcome])

    @property
    def _status(self) -> NDArray[np.uint8]:
        """Status of each outcome, (C + 3,)."""
        return np.array([_ECHO] * (len(self.centre) + 1) + [_NO_ECHO, _NO_ANSWER], dtype=np.uint8)


def _within(x: Floats, low: Floats | float, high: Floats | float) -> Floats:
    """Return `np.clip`, in half its time for a few numbers."""
    return np.minimum(np.maximum(x, low), high)


@dataclass(frozen=True)
class Head:
    """How a network's last numbers are read as a law.

    Attributes:
        near: components placed about the true distance.
        fixed: components placed anywhere on the scale.
        resolution: step of the register, m.
        max_range: of the register, m.
        no_answer: rate at which the sensor does not answer.
    """

    near: int
    fixed: int
    resolution: float
    max_range: float
    no_answer: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no mixture."""
        if self.near < 1 or self.fixed < 0:
            raise SettingError(f"Head needs at least one near component, got {self.near} near and {self.fixed} fixed")
        if not 0 <= self.no_answer < 1:
            raise SettingError(f"Head.no_answer must lie in [0, 1), got {self.no_answer:g}")

    @property
    def components(self) -> int:
        """Number of logistic components."""
        return self.near + self.fixed

    @property
    def width(self) -> int:
        """How many numbers a network must give a ping: logits, places, widths."""
        return 3 * self.components + 2

    def law(self, numbers: Floats, distance: Floats, excess: Floats) -> MixtureLaw:
        """Return the law of n pings from a network's numbers, (n, width)."""
        c = self.components
        logit, place, width = numbers.T[: c + 2], numbers.T[c + 2 : -c], numbers.T[-c:]
        grown = np.exp(logit - logit.max(axis=0))  # scipy's softmax takes longer than all the rest for a few pings
        share = FLOOR + (1.0 - FLOOR * len(logit)) * grown / grown.sum(axis=0)
        near = distance + UNIT_M * np.sinh(_within(place[: self.near], -7.0, 7.0))
        fixed = self.max_range * expit(place[self.near :])
        scale = 0.1 * self.resolution + UNIT_M * np.exp(_within(width, -8.0, 6.0))
        ignorance = excess / (excess + HALF_IGNORANT)
        share = (1.0 - ignorance) * share
        share[-2:] += 0.5 * ignorance
        return MixtureLaw(
            distance, share, np.concatenate([near, fixed]), scale * (1.0 + WIDENING * excess), self, excess
        )


@dataclass(frozen=True)
class Inputs:
    """What a network is told of a ping, and the ranges in which it learned.

    Attributes:
        names: of the conditions and covariates, "distance" first.
        low, high: learned range of each.
        folded: whether bearings and incidences were of one sign, so that only their size counts.
        tied: whether incidence always equalled bearing, so that only bearing is told.
    """

    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    folded: bool = False
    tied: bool = False

    @classmethod
    def of(cls, ping: Ping, names: tuple[str, ...]) -> Inputs:
        """Learn ranges from pings.

        Args:
            ping: the conditions of a recording.
            names: those that were logged, "distance" first; incidence is left out where it always equals bearing.
        """
        turned = np.concatenate([ping.angle, ping.incidence])
        folded = bool(np.all(turned >= 0) or np.all(turned <= 0))
        tied = bool(np.allclose(np.abs(ping.angle), np.abs(ping.incidence)))
        used = tuple(name for name in names if not (tied and name == "incidence"))
        value = cls(used, (), (), folded, tied).raw(ping)
        return cls(used, tuple(map(float, value.min(axis=0))), tuple(map(float, value.max(axis=0))), folded, tied)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> Inputs:
        """Build from plain data, where tuples are lists."""
        ranges = {key: tuple(map(float, data[key])) for key in ("low", "high")}
        if not len(data["names"]) == len(ranges["low"]) == len(ranges["high"]):
            raise ValueError("inputs: names, low and high differ in number")
        return cls(tuple(data["names"]), ranges["low"], ranges["high"], bool(data["folded"]), bool(data["tied"]))

    @property
    def width(self) -> int:
        """Number of features."""
        return len(self.names) + 1

    def raw(self, ping: Ping) -> Floats:
        """Return the named quantities, (n, names).

        Raises:
            SettingError: a covariate is missing.
        """
        return np.stack([self._column(ping, name) for name in self.names], axis=1)

    def _column(self, ping: Ping, name: str) -> Floats:
        if name in NATURAL_SPAN:
            value = getattr(ping, name)
            return np.abs(value) if self.folded and name in ("angle", "incidence") else value
        if name not in ping.covariates:
            raise SettingError(
                f"Ping has no covariate {name!r}, which this model was trained on: give it for every ping"
            )
        return ping.covariates[name]

    def features(self, ping: Ping) -> tuple[Floats, Floats]:
        """Return features within -1..1, (n, width), and the excess over the learned ranges, (n,)."""
        value, (low, high, span) = self.raw(ping), self._ranges
        inside = _within(value, low, high)
        excess = (np.abs(value - inside) / span).max(axis=1)
        if self.tied:
            apart = np.abs(np.abs(ping.incidence) - np.abs(ping.angle))
            excess = np.maximum(excess, np.where(apart > 1e-9, apart / 0.5, 0.0))
        scaled = 2.0 * (inside - low) / span - 1.0
        return np.concatenate([scaled, self._log_distance(inside[:, :1])], axis=1), excess

    @cached_property
    def _ranges(self) -> tuple[Floats, Floats, Floats]:
        """Low, high and the span by which each quantity is scaled: no less than what is natural to it."""
        known = zip(self.names, self.high, strict=True)
        natural = [NATURAL_SPAN.get(name, 1e-6 + 0.1 * abs(high)) for name, high in known]
        low, high = np.array(self.low), np.array(self.high)
        return low, high, np.maximum(high - low, natural)

    def _log_distance(self, distance: Floats) -> Floats:
        near, far = math.log(self.low[0] + 0.02), math.log(self.high[0] + 0.02)
        return 2.0 * (np.log(distance + 0.02) - near) / max(far - near, 0.1) - 1.0


class MlpModel:
    """A multilayer perceptron from a ping's conditions to its law.

    Args:
        inputs: what the network is told.
        head: how its numbers are read.
        layers: weights (out, in) and biases (out,) of each layer; tanh between them.
        about: plain data on its making, kept in model.json.
        card: text of the folder's README.md.
    """

    remembers = False

    def __init__(
        self,
        inputs: Inputs,
        head: Head,
        layers: list[tuple[np.ndarray, np.ndarray]],
        about: dict[str, Any] | None = None,
        card: str = "",
    ) -> None:
        self.inputs, self.head, self.about, self.card = inputs, head, about or {}, card
        self.layers = [(w.astype(np.float64), b.astype(np.float64)) for w, b in layers]

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.head.resolution

    def law(self, ping: Ping, past: Reading | None = None) -> MixtureLaw:
        """Return the law of n pings; the past is not looked at."""
        x, excess = self.inputs.features(ping)
        for weight, bias in self.layers[:-1]:
            x = np.tanh(x @ weight.T + bias)
        weight, bias = self.layers[-1]
        return self.head.law(x @ weight.T + bias, ping.distance, excess)

    @property
    def sizes(self) -> list[int]:
        """Widths of all layers, the input first."""
        return [self.layers[0][0].shape[1], *(len(bias) for _, bias in self.layers)]

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the weights as plain data."""
        return {
            "kind": "mlp",
            "sizes": self.sizes,
            "inputs": asdict(self.inputs),
            "head": asdict(self.head),
            "about": self.about,
        }

    def write_weights(self, folder: Path) -> None:
        """Write the weights, and the card where there is one, into a folder."""
        tensors: dict[str, np.ndarray] = {}
        for i, (weight, bias) in enumerate(self.layers):
            tensors |= {f"{i}.weight": weight.astype(np.float32), f"{i}.bias": bias.astype(np.float32)}
        save_file(tensors, folder / WEIGHTS_FILE)
        (folder / WEIGHTS_FILE).chmod(0o644)
        if self.card:
            (folder / "README.md").write_text(self.card, encoding="utf-8")

    @classmethod
    def load(cls, folder: Path, data: dict[str, Any]) -> MlpModel:
        """Read a saved network.

        Args:
            folder: that holds the weights.
            data: its model.json.

        Raises:
            ModelError: model.json or the weights are damaged, or belong to something else.
        """
        try:
            inputs = Inputs.from_dict(data["inputs"])
            head, sizes = Head(**data["head"]), [int(size) for size in data["sizes"]]
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ModelError(f"{folder / 'model.json'}: does not describe a network ({error}); train it anew") from None
        if len(sizes) < 2 or sizes[0] != inputs.width or sizes[-1] != head.width or min(sizes) < 1:
            wanted = f"{inputs.width} features to {head.width} numbers"
            raise ModelError(f"{folder / 'model.json'}: layers {sizes} do not lead from {wanted}; train it anew")
        card = folder / "README.md"
        text = card.read_text(encoding="utf-8") if card.is_file() else ""
        return cls(inputs, head, read_layers(folder / WEIGHTS_FILE, sizes), data.get("about", {}), text)


def read_layers(path: Path, sizes: list[int]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Read weights and biases of the given sizes, and nothing else, from a safetensors file.

    Raises:
        ModelError: the file is missing, truncated, of another size than the sizes call for, or holds other things.
    """
    shapes: dict[str, tuple[int, ...]] = {f"{i}.weight": (sizes[i + 1], sizes[i]) for i in range(len(sizes) - 1)}
    shapes |= {f"{i}.bias": (sizes[i + 1],) for i in range(len(sizes) - 1)}
    needed = 4 * sum(int(np.prod(shape)) for shape in shapes.values())
    try:
        size = os.path.getsize(path)
        if not needed <= size <= needed + HEADER_BYTES:
            raise ModelError(f"{path}: has {size} bytes, expected {needed} and a header; it is damaged or foreign")
        tensors = load_file(path)
    except FileNotFoundError:
        raise ModelError(f"{path}: is missing; the folder of a network holds its weights beside model.json") from None
    except (SafetensorError, OSError) as error:
        raise ModelError(f"{path}: cannot be read as safetensors ({error}); it is damaged or foreign") from None
    if {name: value.shape for name, value in tensors.items()} != shapes:
        raise ModelError(f"{path}: holds other tensors than model.json calls for ({', '.join(shapes)})")
    if not all(value.dtype == np.float32 and np.all(np.isfinite(value)) for value in tensors.values()):
        raise ModelError(f"{path}: holds numbers that are not finite float32; it is damaged")
    return [(tensors[f"{i}.weight"], tensors[f"{i}.bias"]) for i in range(len(sizes) - 1)]
