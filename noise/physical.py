"""PhysicalModel: a stack of effects on an ideal sonar. First echo wins.

Paths are independent given the level: no echo comes before exact range z with probability
S(z) = exp(-clutter z) * prod_k (1 - pi_k F_k(z)), averaged over the latent level; a register's probability is the
difference of S at its edges, and no echo is S at the end of listening. Replacements (atoms) are mixed in last.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor

from acquisition import ModelError, Ping, Reading
from noise.effects import CATALOGUE, Conditions, Effect, State
from noise.effects.base import DETECTION_WIDTH_DB, new_path, number, wall_level_db
from noise.law import EchoLaw, Floats
from noise.model import MAX_RANGE

EVERYTHING = 1e6  # m; beyond any gate
TINY = 1e-300  # keeps the logarithm of an excluded reading finite where gradients are taken


class PhysicalLaw(EchoLaw):
    """The law of a `State`. Array methods come from `EchoLaw`; `log_prob_tensor` keeps gradients."""

    def __init__(self, state: State, distance: Floats, resolution: float, max_range: float) -> None:
        super().__init__(distance, resolution, max_range)
        self.state = state

    def log_survival(self, z: Tensor) -> Tensor:
        """Return log P(nothing registered at an exact range <= z), for z (..., 1, n) -> (..., Q, n)."""
        state = self.state
        total = -state.clutter_per_metre * torch.clamp(torch.minimum(z, state.gate), min=0.0)
        for path in state.paths:
            total = total + torch.log1p(-path.detection(state.width_db) * path.arrival(z) * (1.0 - 1e-15))
        return total

    def arrival_tensor(self, edge: Tensor) -> Tensor:
        """Return P(echo, register <= edge) for register edges in m, (..., n), atoms included."""
        state = self.state
        if state.step > 0:
            edge = (torch.floor(edge / state.step + 1e-9) + 0.5) * state.step
        # a finite "everything": the derivative of inf / scale is not a number
        z = torch.minimum((torch.clamp(edge, max=EVERYTHING) - state.offset) / state.scale, state.gate)
        log_weight = state.log_weight - torch.logsumexp(state.log_weight, dim=0)
        core = -torch.expm1(torch.logsumexp(self.log_survival(z.unsqueeze(-2)) + log_weight, dim=-2))
        for atom in state.atoms:
            core = (1.0 - atom.weight) * core + atom.weight * atom.cdf(edge)
        return core

    def no_answer_tensor(self) -> Tensor:
        """Return P(no answer), (n,)."""
        out = torch.zeros(len(self), dtype=torch.float64)
        for atom in self.state.atoms:
            out = (1.0 - atom.weight) * out + atom.weight * atom.no_answer
        return out

    def log_prob_tensor(self, reading: Reading) -> Tensor:
        """Return the log probability of each reading, nats, (n,), differentiable; bounded below by log(1e-300)."""
        step = self.step(reading.range)
        edges = torch.from_numpy(self._edges(np.stack([step - 1, step])))
        low, high = self.arrival_tensor(edges)
        low = torch.where(torch.from_numpy(step <= 1), torch.zeros_like(low), low)
        echo = self.arrival_tensor(torch.full((len(self),), torch.inf, dtype=torch.float64))
        no_answer = self.no_answer_tensor()
        mass = torch.stack([1.0 - echo - no_answer, high - low, no_answer])
        chosen = mass.gather(0, torch.from_numpy(reading.status.astype(np.int64))[None])[0]
        return torch.log(torch.clamp(chosen, min=TINY))

    def _edges(self, step: np.ndarray) -> Floats:
        return np.where(step >= self.last_step, np.inf, (step + 0.5) * self.resolution)

    def arrival(self, z: Floats) -> Floats:
        """Return P(an echo is registered at a range <= z)."""
        with torch.no_grad():
            edge = torch.as_tensor(z, dtype=torch.float64)
            return np.broadcast_to(self.arrival_tensor(edge).numpy(), np.shape(z)).copy()

    @property
    def no_answer(self) -> Floats:
        """P(the sensor does not answer), (n,)."""
        with torch.no_grad():
            return self.no_answer_tensor().numpy()


class PhysicalModel:
    """An ideal sonar with effects on it.

    Args:
        effects: any number of effects, at most one of each id.
        resolution: step of the register, m.
        max_range: of the register, m.

    >>> from noise.effects import CATALOGUE
    >>> warm = PhysicalModel([CATALOGUE["sound_speed"](temperature_c=40.0)])
    >>> bool(warm.law(Ping.of(distance=3.0)).quantile(0.5)[0] < 3.0)
    True
    """

    def __init__(self, effects: Iterable[Effect] = (), resolution: float = 0.001, max_range: float = MAX_RANGE) -> None:
        self.effects = tuple(sorted(effects, key=lambda effect: (effect.stage, effect.name)))
        self.resolution = resolution
        self.max_range = max_range
        names = [effect.name for effect in self.effects]
        if len(set(names)) < len(names):
            raise ModelError(f"PhysicalModel holds an effect twice: {', '.join(names)}; give each once")

    @property
    def remembers(self) -> bool:
        """Whether any effect looks at the previous reading."""
        return any(effect.remembers for effect in self.effects)

    def state(self, conditions: Conditions) -> State:
        """Return what the law is made of, every effect applied at its stage."""
        direct = new_path("direct", conditions.distance, wall_level_db(conditions.distance))
        state = State(
            conditions,
            (direct,),
            log_weight=torch.zeros((1, 1), dtype=torch.float64),
            width_db=number(DETECTION_WIDTH_DB),
            clutter_per_metre=number(0.0),
            scale=number(1.0),
            offset=number(0.0),
            gate=number(self.max_range),
        )
        for effect in self.effects:
            state = effect.apply(state)
        return state

    def law_of(self, conditions: Conditions) -> PhysicalLaw:
        """Return the law of a batch of tensors; gradients flow from its `log_prob_tensor` to the parameters."""
        return PhysicalLaw(self.state(conditions), conditions.distance.numpy(), self.resolution, self.max_range)

    def law(self, ping: Ping, past: Reading | None = None) -> PhysicalLaw:
        """Return the law of n pings, given the reading before each."""
        return self.law_of(Conditions.of(ping, past))

    def to_dict(self) -> dict[str, object]:
        """Return the model as plain data."""
        effects = {effect.name: effect.values for effect in self.effects}
        return {"kind": "physical", "resolution": self.resolution, "max_range": self.max_range, "effects": effects}

    @classmethod
    def from_dict(cls, data: dict[str, object]) -> PhysicalModel:
        """Build a model from `to_dict`.

        Raises:
            ModelError: an effect is not in the catalogue, or a value is not usable.
        """
        effects = data.get("effects", {})
        if not isinstance(effects, dict):
            raise ModelError("model: `effects` must map effect ids to parameters")
        unknown = [name for name in effects if name not in CATALOGUE]
        if unknown:
            raise ModelError(f"model: effect {unknown[0]!r} is not in the catalogue: {', '.join(CATALOGUE)}")
        stack = [CATALOGUE[name](**values) for name, values in effects.items()]
        return cls(stack, float(str(data["resolution"])), float(str(data["max_range"])))

    def __repr__(self) -> str:
        return f"PhysicalModel([{', '.join(map(repr, self.effects))}], resolution={self.resolution:g})"
