"""A learned law with the differences that a diagnosis found: `compose("srf08-mlp", diagnosis)`, a sonar for training.

The law of the learned model takes the place of the direct path of a physical law, so that all effects of the catalogue
act on it. Effects that change the direct path are applied as differences between the simulation of the diagnosis and
its recording: ranges are stretched by the ratio of path lengths and shifted by the difference of lags; the probability
of an echo is multiplied by the ratio of detection probabilities, p' = p d_rec / d_sim, or that of a miss where echoes
become more frequent, 1 - p' = (1 - p) (1 - d_rec) / (1 - d_sim). Paths, false alarms and replaced readings compete with
the learned law as they do with a direct path.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.special import ndtri
from torch import Tensor

from acquisition import ModelError, Ping, Reading, SettingError, previous
from acquisition.arguments import checked
from acquisition.arrays import Bits, Floats, Ints
from acquisition.ping import TEMPERATURE
from noise.effects import CATALOGUE, Atom, Conditions, Effect, Path, State
from noise.effects.state import number
from noise.faults import FaultyLaw, HasWeights
from noise.fitting.empirical import EmpiricalModel
from noise.law import EchoLaw, UniformSource
from noise.learned.persistence import Persistence
from noise.model import SonarModel, StatefulModel, follow, listener
from noise.physical import END, PhysicalLaw, PhysicalModel

WEIGHTS = ("probability", "presence", "per_metre")  # parameters that say how often an effect acts
N_NODES = 15  # equally probable points that stand for added normal scatter
# limits of a state that has none
UNBOUNDED: dict[str, Any] = {"gate": number(END), "blind_range": None, "step": 0.0}
Values = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class LearnedPath(Path):
    """The echoes of another law as a path, with changed detection, stretch, delay and scatter.

    Attributes:
        law: law of the echoes, of n pings.
        probability: probability of an echo, (1, n).
        stretch: factor on ranges, (n,).
        offsets: weighted delays, as range, m, (k, n).
        weights: of the delays, (k,).
    """

    law: EchoLaw
    probability: Tensor
    stretch: Floats
    offsets: Floats
    weights: Floats

    def detection(self, width_db: Tensor) -> Tensor:
        """Return the probability of an echo, (1, n)."""
        return self.probability

    def missing(self, width_db: Tensor) -> Tensor:
        """Return the probability of no echo, (1, n)."""
        return 1.0 - self.probability

    def _survival(self, z: Tensor) -> Tensor:
        return 1.0 - self._mean(self.law._arrival, z)

    def _between(self, low: Tensor, high: Tensor) -> Tensor:
        return self._mean(self.law._between, low, high)

    def _mean(self, function: Callable[..., Floats], *edges: Tensor) -> Tensor:
        """Return the mean of a function of the law's own ranges over the delays, given an echo."""
        shape = torch.broadcast_shapes(*(edge.shape for edge in edges), self.probability.shape)
        own = [self._own(edge.expand(shape).numpy()) for edge in edges]
        value = function(*(each.reshape(-1, shape[-1]) for each in own)).reshape(own[0].shape)
        given = np.divide(value, self._echo, out=np.zeros_like(value), where=self._echo > 0)
        return torch.from_numpy(np.clip(np.tensordot(self.weights, given, 1), 0.0, 1.0))

    def _own(self, z: Floats) -> Floats:
        offsets = self.offsets.reshape(len(self.offsets), *[1] * (z.ndim - 1), -1)
        return (z - offsets) / self.stretch

    @cached_property
    def _echo(self) -> Floats:
        return self.law.echo


class ComposedLaw(PhysicalLaw):
    """The law of a state whose first path is another law.

    Attributes:
        own: the other law, of n pings.
        persists: whether outcome and range are drawn from a number each, so that a part of both may persist.
    """

    uniform_per_ping = True

    def __init__(self, state: State, own: EchoLaw, distance: Floats, persists: bool) -> None:
        super().__init__(state, distance, own.resolution, own.max_range)
        self.own, self.persists = own, persists

    @property
    def extrapolates(self) -> Bits:
        """Whether the other law extrapolates, (n,)."""
        return self.own.extrapolates

    def _sample(self, rng: UniformSource) -> Reading:
        if not self.persists:
            return super()._sample(rng)
        (which, where), echo = rng.random((2, len(self))), self.echo
        return self._reading(which, echo, where * echo)


class ComposedModel:
    """A model with the differences between two stacks of effects: those of a simulation and of a recording.

    Args:
        model: model whose laws have probabilities.
        before: effects of the simulation that act on the direct path.
        after: effects of the recording: the same with other parameters, and added paths and replacements.

    Raises:
        SettingError: the law of the model can only be sampled.
    """

    @checked
    def __init__(self, model: SonarModel, before: Iterable[Effect], after: Iterable[Effect]) -> None:
        if not listener(model).law(Ping.of(distance=1.0)).has_probabilities:
            raise SettingError(
                f"compose: a {type(model).__name__} can only be sampled; choose a model with probabilities, srf08-mlp"
            )
        self.model = model
        self.before, self.after = (EmpiricalModel(stack, model.resolution, END) for stack in (before, after))
        # what is added at random is drawn anew at every ping
        self.persistence: Persistence | None = None if _is_more(self.after) else getattr(model, "persistence", None)
        self.causes: tuple[str, ...] = getattr(model, "causes", ("none",))

    @property
    def resolution(self) -> float:
        """Step of the register, m."""
        return self.model.resolution

    @property
    def remembers(self) -> bool:
        """Whether the law depends on the previous reading."""
        return self.model.remembers or self.after.remembers

    @checked
    def law(self, ping: Ping, past: Reading | None = None, sensors: Ints | None = None) -> EchoLaw:
        """Return the law of n pings, given the previous reading of each; see `StatefulModel.law`."""
        model = self.model
        own = model.law(ping, past, sensors) if isinstance(model, StatefulModel) else model.law(ping, past)
        return self._changed(own, Conditions.of(ping, past))

    @checked
    def follow(self, ping: Ping, reading: Reading) -> EchoLaw:
        """Return the law of every ping of a recording given all earlier pings of its run, (n,)."""
        past = previous(reading, ping.run)
        return self._changed(follow(self.model, ping, reading), Conditions.of(ping, past))

    def _changed(self, law: EchoLaw, conditions: Conditions, persists: bool = True) -> EchoLaw:
        if isinstance(law, FaultyLaw):  # which ping has a fault, and what it reads, does not persist
            first, *faults = law.parts
            parts = [self._changed(first, conditions), *(self._changed(each, conditions, False) for each in faults)]
            return FaultyLaw(parts, law.rate)
        with torch.no_grad():
            before, after = self.before.state(conditions), self.after.state(conditions)
            factor = after.scale / before.scale
            state = replace(
                after,
                paths=(_learned_path(law, before, after), *after.paths[1:]),
                scale=factor,
                offset=after.offset - factor * before.offset,
                **{name: none for name, none in UNBOUNDED.items() if getattr(before, name) == getattr(after, name)},
            )
        if np.any(law.no_answer > 0):
            state = state.with_atom(Atom(torch.tensor(law.no_answer), torch.zeros_like, number(0.0), number(1.0)))
        return ComposedLaw(state, law, conditions.distance.numpy(), persists and self.persistence is not None)

    def fresh(self) -> ComposedModel:
        """Return a copy with an empty state of its own if the model is stateful."""
        return ComposedModel(listener(self.model), self.before.effects, self.after.effects)

    def reset(self, sensors: ArrayLike | None = None) -> None:
        """Clear the state of all sensors, or of those given by index or mask."""
        if isinstance(self.model, StatefulModel):
            self.model.reset(sensors)

    def to_dict(self) -> dict[str, object]:
        """Return model and effects as plain data.

        Raises:
            ModelError: the model cannot be saved.
        """
        inner: Any = self.model
        if not hasattr(inner, "to_dict"):
            raise ModelError(f"ComposedModel: a {type(inner).__name__} cannot be saved; it has no to_dict()")
        both = {"before": self.before.to_dict(), "after": self.after.to_dict()}
        stacks = {name: {key: data[key] for key in ("effects", "terms")} for name, data in both.items()}
        return {"kind": "composed", "model": inner.to_dict(), **stacks}

    @checked
    def write_weights(self, folder: FilePath) -> None:
        """Write the weights of the model, if any, into a folder."""
        if isinstance(self.model, HasWeights):
            self.model.write_weights(folder)

    @classmethod
    @checked
    def load(
        cls, folder: FilePath, data: dict[str, object], load_kind: Callable[[FilePath, object], SonarModel]
    ) -> ComposedModel:
        """Load a saved model; `load_kind` loads the model without the differences.

        Raises:
            ModelError: an effect is unknown or a value is invalid.
        """
        content: dict[str, Any] = data
        try:
            register = {"resolution": 0.001, "max_range": END}  # those of the model are used
            before, after = (EmpiricalModel.from_dict({**register, **content[key]}) for key in ("before", "after"))
            return cls(load_kind(folder, content["model"]), before.effects, after.effects)
        except (KeyError, TypeError, AttributeError, SettingError) as error:
            raise ModelError(f"{folder / 'model.json'}: does not describe effects on a model ({error})") from None

    def __repr__(self) -> str:
        return f"ComposedModel({type(self.model).__name__}, {[effect.name for effect in self.after.effects]})"


def with_differences(
    model: SonarModel, before: Values, causes: Values, common: Sequence[Effect] = ()
) -> tuple[ComposedModel, dict[str, str]]:
    """Return a model with the causes of a difference, and why some could not be added, by effect.

    Args:
        model: model whose laws have probabilities.
        before: parameters of the effects of the simulation, by effect.
        causes: parameters of the recording in the effects in which it differs, by effect.
        common: further effects that both have.
    """
    shared = {name: values for name, values in before.items() if not adds(name)}
    after, left_out = dict(shared), dict[str, str]()
    for name, values in causes.items():
        own = before.get(name, {})
        if reason := _obstacle(name, own, values):
            left_out[name] = reason
        else:
            after[name] = _known(name, _added(own, values) if adds(name) else values)
    return ComposedModel(model, [*_built(shared), *common], [*_built(after), *common]), left_out


def _built(values: Values) -> list[Effect]:
    return [CATALOGUE[name](**each) for name, each in values.items()]


def adds(name: str) -> bool:
    """Return whether an effect adds a path, false alarms or replaced readings, rather than change the direct path."""
    return _is_more(PhysicalModel([CATALOGUE[name]()]))


def _is_more(model: PhysicalModel) -> bool:
    """Return whether a model has more than a direct path."""
    state = model.state(Conditions.of(Ping.of(distance=1.0)))
    return len(state.paths) > 1 or bool(state.atoms) or state.clutter is not None


def _obstacle(name: str, own: Mapping[str, float], values: Mapping[str, float]) -> str:
    """Return why the difference in an effect cannot be added to another law; empty if it can."""
    if name not in CATALOGUE:
        return "not an effect of the catalogue"
    if all(p.covariate and p.covariate != TEMPERATURE for p in CATALOGUE[name].parameters):
        return "a property of the log, which an environment with its own latency does not share"
    if adds(name) and any(values.get(key, 1.0) <= own.get(key, 0.0) for key in WEIGHTS if key in own):
        return "less frequent than in the simulation, and a learned law cannot be freed of it"
    if name == "travel_time_jitter" and any(values[key] < own[key] for key in own if key in values):
        return "less scatter than in the simulation cannot be taken out of a learned law"
    if name == "range_gate" and values.get("listen_m", END) > own.get("listen_m", END):
        return "echoes beyond the end of the simulated window are unknown"
    return ""


def _known(name: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return the values of an effect's own parameters; a cause may state further numbers."""
    return {p.name: values[p.name] for p in CATALOGUE[name].parameters if p.name in values}


def _added(own: Mapping[str, float], values: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters of an added effect: how often it acts beyond its rate in the simulation."""
    return {key: value - own.get(key, 0.0) if key in WEIGHTS else value for key, value in values.items()}


def _learned_path(law: EchoLaw, before: State, after: State) -> LearnedPath:
    """Return the law's echoes, changed as the direct path differs between two states."""
    old, new = before.direct, after.direct
    n = len(law)
    stretch = (new.length / torch.clamp(old.length, min=1e-3)).expand(n).numpy()
    delay = (_mean(after, new.lag) - _mean(before, old.lag)).expand(n).numpy()
    sigma = torch.sqrt(torch.clamp(new.spread**2 - old.spread**2, min=0.0)).expand(n).numpy()
    noise = ndtri((np.arange(N_NODES) + 0.5) / N_NODES) if np.any(sigma > 0) else np.zeros(1)
    slips = (number([0.0]), number([1.0])) if len(old.slip_m) > 1 else (new.slip_m, new.slip_weight)
    offsets = delay + slips[0].numpy()[:, None, None] + noise[:, None] * sigma
    weights = np.repeat(slips[1].numpy() / len(noise), len(noise))
    probability = torch.from_numpy(_probability(law, before, after))[None]
    return LearnedPath(
        **{**vars(new), "name": "learned"},
        law=law,
        probability=probability,
        stretch=stretch,
        offsets=offsets.reshape(-1, n),
        weights=weights,
    )


def _probability(law: EchoLaw, before: State, after: State) -> Floats:
    """Return P(echo | answer) of a law, changed by the ratio of the detection probabilities of two states, (n,)."""
    n = len(law)
    p = np.clip(law.echo / np.maximum(1.0 - law.no_answer, 1e-12), 0.0, 1.0)
    old, new = (_mean(state, state.direct.detection(state.width_db)).expand(n).numpy() for state in (before, after))
    missed, misses = (_mean(state, state.direct.missing(state.width_db)).expand(n).numpy() for state in (before, after))
    loss = np.divide(np.minimum(new, old), old, out=np.ones(n), where=old > 0)
    gain = np.divide(np.minimum(misses, missed), missed, out=np.ones(n), where=missed > 0)
    return np.where(new <= old, p * loss, 1.0 - (1.0 - p) * gain)


def _mean(state: State, value: Tensor) -> Tensor:
    """Return a quantity averaged over the nodes of the latent level if it depends on them, (n,) or scalar."""
    if value.ndim < 2:
        return value
    weight = torch.softmax(state.log_weight, dim=0)
    return (weight * value).sum(0) if len(value) > 1 else value[0]
