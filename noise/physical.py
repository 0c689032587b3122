"""PhysicalModel: a stack of effects on an ideal sonar, which reports the first echo.

Paths are independent given the level. The survival function, the probability of no arrival up to exact range z, is
S(z) = C(z) * prod_k (1 - pi_k F_k(z)), with C that of clutter, averaged over the latent level. The probability of a
register step is the difference of S at its edges, that of no echo is S at the end of the listening window.
Replacements (atoms) are mixed in last. Differences are formed path by path, so that likelihoods are exact and have
useful gradients far out in the tails.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from acquisition import ModelError, Ping, Reading
from acquisition.arguments import checked
from acquisition.brief import shortened
from acquisition.ping import check_pairs
from noise.effects import CATALOGUE, Conditions, Effect, Path, State
from noise.effects.state import DETECTION_WIDTH_DB, Atom, direct_path, number
from noise.law import EchoLaw, Floats
from noise.model import MAX_RANGE

MIN_PROBABILITY = 1e-300  # keeps the logarithm of an impossible reading finite where gradients are taken
END = 1e4  # m; end of the register: beyond any range, but finite for finite gradients


class PhysicalLaw(EchoLaw):
    """The law of a `State`; `log_prob_tensor` is differentiable in the parameters of the effects."""

    def __init__(
        self, state: State, distance: Floats, resolution: float, max_range: float, origin: float = 0.0
    ) -> None:
        super().__init__(distance, resolution, max_range)
        self.state, self.origin = state, origin

    def register_to_range(self, edge: Tensor) -> Tensor:
        """Return the exact range that corresponds to a register edge, m, (..., n)."""
        state = self.state
        if state.step > 0:
            edge = (torch.floor((edge - self.origin) / state.step + 1e-9) + 0.5) * state.step + self.origin
        return torch.minimum((edge - state.offset) / state.scale, state.gate)

    def survival(self, z: Tensor) -> Tensor:
        """Return the survival function P(no arrival at an exact range <= z), for z (..., n)."""
        z = z.unsqueeze(-2)
        paths = zip(self.state.paths, self._detection, strict=True)
        parts = [self._path_survival(path, detection, z) for path, detection in paths]
        return self._average(self._clutter_survival(z) * math.prod(parts[1:], start=parts[0]))

    def between_tensor(self, low: Tensor, high: Tensor) -> Tensor:
        """Return P(registered at an exact range in (low, high]), (..., n), exact in the tails.

        With S = prod u_k, S(low) - S(high) is a sum of positive terms:
        sum_k prod_{j<k} u_j(high) (u_k(low) - u_k(high)) prod_{j>k} u_j(low).
        """
        low, high = low.unsqueeze(-2), high.unsqueeze(-2)
        paths = list(zip(self.state.paths, self._detection, strict=True))
        so_far = self._clutter_survival(high)
        total = so_far * self._path_between(*paths[0], low, high)
        if self.state.clutter is not None:
            total = total + (self._clutter_survival(low) - so_far) * self._path_survival(*paths[0], low)
        for before, path in pairwise(paths):
            so_far = so_far * self._path_survival(*before, high)
            total = total * self._path_survival(*path, low) + so_far * self._path_between(*path, low, high)
        return self._average(total)

    def _path_between(self, path: Path, detection: tuple[Tensor, Tensor], low: Tensor, high: Tensor) -> Tensor:
        """Return P(a path is detected and arrives at an exact range in (low, high])."""
        return detection[1] * path.between(self._clipped(low), self._clipped(high))

    def _clipped(self, z: Tensor) -> Tensor:
        """Return the range, clipped below at the blind range."""
        return z if self.state.blind_range is None else torch.maximum(z, self.state.blind_range)

    @cached_property
    def _detection(self) -> list[tuple[Tensor, Tensor]]:
        """Probabilities of a miss and of a detection, (Q, n) each, for every path."""
        width = self.state.width_db
        return [(path.missing(width), path.detection(width)) for path in self.state.paths]

    def _path_survival(self, path: Path, detection: tuple[Tensor, Tensor], z: Tensor) -> Tensor:
        """Return P(a path is not registered at an exact range <= z); arrivals in the blind range are lost."""
        missed, detected = detection
        late = path.survival(self._clipped(z))
        if self.state.blind_range is not None:
            late = late + 1.0 - path.survival(self.state.blind_range)
        return missed + detected * late

    def _clutter_survival(self, z: Tensor) -> Tensor | float:
        """Return P(no false detection before z)."""
        clutter = self.state.clutter
        return 1.0 if clutter is None else clutter.survival(z, self.state.blind_range)

    def _average(self, by_level: Tensor) -> Tensor:
        if len(self.state.log_weight) == 1:
            return by_level.squeeze(-2)
        return (torch.softmax(self.state.log_weight, dim=0) * by_level).sum(-2)

    def arrival_tensor(self, edge: Tensor) -> Tensor:
        """Return P(echo, register <= edge) for register edges in m, (..., n), atoms included."""
        edge = torch.clamp(edge, -END, END)
        there = 1.0 - self.survival(self.register_to_range(edge))
        for atom, echo in zip(self.state.atoms, self._echo_of_atoms, strict=True):
            there = (1.0 - atom.weight) * there + atom.weight * echo * atom.cdf(edge)
        return there

    @cached_property
    def _echo_of_atoms(self) -> list[Tensor | float]:
        """Factor of the distribution of each atom: the probability of an echo before it, if it replaces echoes only."""
        atoms = self.state.atoms
        return [self._any_echo(atoms[:k]) if atom.of_echo else 1.0 for k, atom in enumerate(atoms)]

    def no_answer_tensor(self) -> Tensor:
        """Return P(no answer), (n,)."""
        out = torch.zeros(len(self), dtype=torch.float64)
        for atom in self.state.atoms:
            if not atom.of_echo:
                out = (1.0 - atom.weight) * out + atom.weight * atom.no_answer
        return out

    def no_echo_tensor(self) -> Tensor:
        """Return P(the sensor answers that there is no echo), (n,)."""
        out = self.survival(self.register_to_range(torch.full((len(self),), END, dtype=torch.float64)))
        for atom in self.state.atoms:
            if not atom.of_echo:
                out = (1.0 - atom.weight) * out + atom.weight * atom.no_echo
        return out

    def any_echo_tensor(self) -> Tensor:
        """Return P(echo), (n,), exact where echoes are rare, unlike 1 - P(no echo)."""
        return self._any_echo(self.state.atoms)

    def _any_echo(self, atoms: Sequence[Atom]) -> Tensor:
        """Return P(echo) after some of the atoms, (n,)."""
        end = torch.full((len(self),), END, dtype=torch.float64)
        out = self.between_tensor(self.register_to_range(-end), self.register_to_range(end))
        for atom in atoms:
            if not atom.of_echo:
                out = (1.0 - atom.weight) * out + atom.weight * (1.0 - atom.no_echo - atom.no_answer)
        return out

    def echo_tensor(self, step: np.ndarray) -> Tensor:
        """Return P(echo at the given register step), (n,)."""
        low, high = self._edges(step - 1), self._edges(step)
        out = self.between_tensor(self.register_to_range(low), self.register_to_range(high))
        for atom, echo in zip(self.state.atoms, self._echo_of_atoms, strict=True):
            out = (1.0 - atom.weight) * out + atom.weight * echo * (atom.cdf(high) - atom.cdf(low))
        return out

    def probability_tensor(self, reading: Reading) -> Tensor:
        """Return the probability of each reading, (n,), differentiable."""
        kinds = self.no_echo_tensor(), self.echo_tensor(self.step(reading.range)), self.no_answer_tensor()
        mass = torch.stack(torch.broadcast_tensors(*kinds))
        status = torch.from_numpy(reading.status.astype(np.int64)).expand(mass.shape[1:])
        return mass.gather(0, status[None])[0]

    def log_prob_tensor(self, reading: Reading) -> Tensor:
        """Return the log probability of each reading, nats, (n,), differentiable; bounded below by log(1e-300)."""
        return torch.log(torch.clamp(self.probability_tensor(reading), min=MIN_PROBABILITY))

    @checked
    def log_prob(self, reading: Reading) -> Floats:
        """Return the log probability of each reading, nats, (n,); -inf for impossible readings."""
        check_pairs("PhysicalLaw.log_prob.reading", self, reading)
        with torch.no_grad(), np.errstate(divide="ignore"):
            return np.log(np.maximum(self.probability_tensor(reading).numpy(), 0.0))

    def _edges(self, step: np.ndarray) -> Tensor:
        return torch.from_numpy(np.clip(self._edge(step), -END, END))

    def _arrival(self, z: Floats) -> Floats:
        with torch.no_grad():
            edge = torch.as_tensor(z, dtype=torch.float64)
            return np.broadcast_to(self.arrival_tensor(edge).numpy(), np.shape(z)).copy()

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,)."""
        with torch.no_grad():
            return self.no_answer_tensor().numpy()


class PhysicalModel:
    """An ideal sonar with a stack of effects.

    Args:
        effects: effects, at most one of each id.
        resolution: step of the register, m.
        max_range: range of the register's last step, m.

    >>> from noise.effects import CATALOGUE
    >>> warm = PhysicalModel([CATALOGUE["sound_speed"](temperature_c=40.0)])
    >>> bool(warm.law(Ping.of(distance=3.0)).quantile(0.5)[0] < 3.0)
    True
    """

    @checked
    def __init__(self, effects: Iterable[Effect] = (), resolution: float = 0.001, max_range: float = MAX_RANGE) -> None:
        self.effects = tuple(sorted(effects, key=lambda effect: (effect.stage, effect.name)))
        self.resolution = resolution
        self.max_range = max_range
        names = [effect.name for effect in self.effects]
        if len(set(names)) < len(names):
            raise ModelError(f"PhysicalModel has duplicate effects: {', '.join(names)}; give each effect once")

    @property
    def remembers(self) -> bool:
        """Whether any effect depends on the previous reading."""
        return any(effect.remembers for effect in self.effects)

    @checked
    def state(self, conditions: Conditions) -> State:
        """Return the state after all effects are applied in the order of their stages."""
        state = State(
            conditions,
            (direct_path(conditions),),
            log_weight=torch.zeros((1, 1), dtype=torch.float64),
            width_db=number(DETECTION_WIDTH_DB),
            scale=number(1.0),
            offset=number(0.0),
            gate=number(self.max_range),
        )
        return self.applied(state)

    @checked
    def applied(self, state: State) -> State:
        """Return a state after all effects are applied to it."""
        for effect in self.effects:
            state = effect.apply(state)
        return state

    @checked
    def law_of(self, conditions: Conditions) -> PhysicalLaw:
        """Return the law of a batch of tensors, differentiable in the parameters."""
        return PhysicalLaw(self.state(conditions), conditions.distance.numpy(), self.resolution, self.max_range)

    @checked
    def law(self, ping: Ping, past: Reading | None = None) -> PhysicalLaw:
        """Return the law of n pings, given the previous reading of each."""
        return self.law_of(Conditions.of(ping, past))

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data."""
        effects = {effect.name: effect.values for effect in self.effects}
        return {"kind": "physical", "resolution": self.resolution, "max_range": self.max_range, "effects": effects}

    @classmethod
    @checked
    def from_dict(cls, data: dict[str, object]) -> PhysicalModel:
        """Build a model from the output of `to_dict`.

        Raises:
            ModelError: an effect is not in the catalogue, or a value is invalid.
        """
        effects = data.get("effects", {})
        if not isinstance(effects, dict):
            raise ModelError("model: `effects` must map effect ids to parameters")
        unknown = [name for name in effects if name not in CATALOGUE]
        if unknown:
            raise ModelError(f"model: effect {unknown[0]!r} is not in the catalogue: {', '.join(CATALOGUE)}")
        try:
            stack = [CATALOGUE[name](**values) for name, values in effects.items()]
            return cls(stack, float(str(data["resolution"])), float(str(data["max_range"])))
        except (KeyError, TypeError, ValueError) as error:
            raise ModelError(f"model: cannot be built from its parameters ({error}); it may be damaged") from None

    def __repr__(self) -> str:
        return shortened(f"PhysicalModel([{', '.join(map(repr, self.effects))}], resolution={self.resolution:g})")
