"""Alternative ways of sampling the law of a perceptron: eager and compiled torch, numba, a table; compared with numpy.

Each path takes a perceptron and returns a function that samples readings for pings, as `model.law(ping).sample(rng)`
does. All but the table compute the exact law; the table rounds each condition to one of its nodes at random.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import product

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from acquisition import Ping, Reading
from noise.law import Floats
from noise.learned.mixture import FLOOR, UNIT_M, Head
from noise.learned.networks import MlpModel

Draw = Callable[[Ping, np.random.Generator], Reading]
NODES = {"distance": 48, "angle": 7, "incidence": 7, "reflectance": 4}  # of the table; covariates are at their mean
RANKS = 256  # equally likely readings per node of the table


def numpy_path(model: MlpModel) -> Draw:
    """Return the path of the models themselves."""
    return lambda ping, rng: model.law(ping).sample(rng)


def _random_pairs(rng: np.random.Generator, n: int) -> Tensor:
    return torch.from_numpy(rng.random((2, n), dtype=np.float32))


class TorchSampler(torch.nn.Module):
    """Sampling in torch, single precision.

    Args:
        model: whose law to sample.
    """

    def __init__(self, model: MlpModel) -> None:
        super().__init__()
        self.head, self.count = model.head, len(model.layers)
        for k, (weight, bias) in enumerate(model.layers):
            self.register_buffer(f"weight{k}", torch.tensor(weight, dtype=torch.float32))
            self.register_buffer(f"bias{k}", torch.tensor(bias, dtype=torch.float32))

    def forward(self, feature: Tensor, distance: Tensor, random: Tensor) -> tuple[Tensor, Tensor]:
        """Return ranges, m, 0 for no echo, and indices of the outcomes, (n,) each."""
        x = feature
        for k in range(self.count):
            x = torch.addmm(getattr(self, f"bias{k}"), x, getattr(self, f"weight{k}").T)
            x = torch.tanh(x) if k + 1 < self.count else x
        return self._sample(x, distance, random)

    def _sample(self, numbers: Tensor, distance: Tensor, random: Tensor) -> tuple[Tensor, Tensor]:
        head, c = self.head, self.head.components
        share = FLOOR + (1.0 - FLOOR * (c + 2)) * torch.softmax(numbers[:, : c + 2], dim=1)
        edges = share.cumsum(dim=1)[:, :-1] * (1.0 - head.no_answer)
        outcome = (random[0, :, None] >= edges).sum(dim=1)
        peak = outcome.clamp(max=c - 1)[:, None]
        place = numbers[:, c + 2 : 2 * c + 2].gather(1, peak)[:, 0]
        width = numbers[:, 2 * c + 2 :].gather(1, peak)[:, 0]
        near = distance + UNIT_M * torch.sinh(place.clamp(-7.0, 7.0))
        centre = torch.where(outcome < head.near, near, head.max_range * torch.sigmoid(place))
        scale = 0.1 * head.resolution + UNIT_M * torch.exp(width.clamp(-8.0, 6.0))
        exact = torch.where(outcome < c, centre + scale * torch.logit(random[1], 1e-7), random[1] * head.max_range)
        step = torch.round(exact / head.resolution).clamp(1, round(head.max_range / head.resolution))
        return torch.where(outcome <= c, step * head.resolution, 0.0), outcome


def torch_path(model: MlpModel, compiled: bool = False) -> Draw:
    """Return the path in torch, eager or compiled."""
    module = TorchSampler(model).eval()
    run = torch.compile(module, dynamic=False) if compiled else module

    def draw(ping: Ping, rng: np.random.Generator) -> Reading:
        inputs = model.inputs.features(ping)
        with torch.inference_mode():
            feature = torch.from_numpy(inputs.feature.astype(np.float32))
            distance = torch.from_numpy(inputs.distance.astype(np.float32))
            range_, outcome = run(feature, distance, _random_pairs(rng, len(ping)))
        return _reading(range_.numpy().astype(np.float64), outcome.numpy(), model.head)

    return draw


def _reading(range_: Floats, outcome: NDArray[np.int64], head: Head) -> Reading:
    status = np.array([1] * (head.components + 1) + [0, 2], dtype=np.uint8)
    return Reading(np.rint(range_ / head.resolution) * head.resolution, status[outcome])


@numba.njit(cache=True, fastmath={"reassoc", "contract", "nsz"})
def _numbers(feature, weights, biases, sizes, out):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Write the output of the layers for one ping, (in,), to `out`, (width,); weights and biases are concatenated."""
    x, w, b = feature, 0, 0
    for layer in range(len(sizes) - 1):
        inside, outside = sizes[layer], sizes[layer + 1]
        y = np.empty(outside)
        for i in range(outside):
            total = biases[b + i]
            for j in range(inside):
                total += weights[w + i * inside + j] * x[j]
            y[i] = math.tanh(total) if layer + 2 < len(sizes) else total
        x, w, b = y, w + inside * outside, b + outside
    out[:] = x


@numba.njit(cache=True)
def _draw_rows(feature, distance, random, weights, biases, sizes, shape, range_, outcome):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Sample a reading for every ping; shape: near, components, resolution, max_range, answer rate."""
    near, c, resolution, reach, rate = int(shape[0]), int(shape[1]), shape[2], shape[3], shape[4]
    numbers = np.empty(sizes[-1])
    for n in range(len(distance)):
        _numbers(feature[n], weights, biases, sizes, numbers)
        top, total = numbers[: c + 2].max(), 0.0
        for k in range(c + 2):
            total += math.exp(numbers[k] - top)
        upto, k = 0.0, 0
        while k < c + 2:
            upto += rate * (FLOOR + (1.0 - FLOOR * (c + 2)) * math.exp(numbers[k] - top) / total)
            if random[0, n] < upto:
                break
            k += 1
        outcome[n] = k
        range_[n] = 0.0
        if k > c:
            continue
        exact = random[1, n] * reach
        if k < c:
            place, width = numbers[c + 2 + k], min(max(numbers[2 * c + 2 + k], -8.0), 6.0)
            if k < near:
                centre = distance[n] + UNIT_M * math.sinh(min(max(place, -7.0), 7.0))
            else:
                centre = reach / (1.0 + math.exp(-place))
            odds = random[1, n] / (1.0 - random[1, n])
            exact = centre + (0.1 * resolution + UNIT_M * math.exp(width)) * math.log(max(odds, 1e-300))
        range_[n] = min(max(np.rint(exact / resolution), 1.0), np.rint(reach / resolution)) * resolution


def numba_path(model: MlpModel) -> Draw:
    """Return the path in numba: one loop over pings."""
    weights = np.concatenate([weight.ravel() for weight, _ in model.layers])
    biases, sizes = np.concatenate([bias for _, bias in model.layers]), np.array(model.sizes)
    head = model.head
    shape = np.array([head.near, head.components, head.resolution, head.max_range, 1.0 - head.no_answer])

    def draw(ping: Ping, rng: np.random.Generator) -> Reading:
        inputs, n = model.inputs.features(ping), len(ping)
        range_, outcome = np.empty(n), np.empty(n, dtype=np.int64)
        _draw_rows(inputs.feature, inputs.distance, rng.random((2, n)), weights, biases, sizes, shape, range_, outcome)
        return _reading(range_, np.minimum(outcome, head.components + 2), head)

    return draw


def table_path(model: MlpModel) -> Draw:
    """Return the path by table: `RANKS` readings for each node of a grid of conditions, 0 for no echo."""
    axes = _axes(model)
    grid = np.stack([x.ravel() for x in np.meshgrid(*axes, indexing="ij")])
    error = _ranked(model, grid).astype(np.float32)
    sizes = [len(axis) for axis in axes]

    def draw(ping: Ping, rng: np.random.Generator) -> Reading:
        given = (ping.distance, np.abs(ping.angle), np.abs(ping.incidence), ping.reflectance)
        node = np.zeros(len(ping), dtype=np.int64)
        for value, axis, size, fraction in zip(given, axes, sizes, rng.random((len(axes), len(ping))), strict=True):
            place = np.interp(value, axis, np.arange(size))
            node = node * size + np.minimum((place + fraction).astype(np.int64), size - 1)
        found = error[node, rng.integers(RANKS, size=len(ping))]
        step = np.maximum(np.rint((found + ping.distance) / model.resolution), 1.0)
        echo = ~np.isnan(found)
        return Reading(np.where(echo, step * model.resolution, 0.0), echo.astype(np.uint8))

    return draw


def _axes(model: MlpModel) -> list[Floats]:
    """Return the nodes of each quantity: logarithmic in distance, otherwise linear."""
    low, high = (dict(zip(model.inputs.names, ends, strict=True)) for ends in (model.inputs.low, model.inputs.high))
    even = {name: np.linspace(low.get(name, 0.0), high.get(name, 0.0), nodes) for name, nodes in NODES.items()}
    even["distance"] = np.geomspace(low["distance"], high["distance"], NODES["distance"])
    return list(even.values())


def _ranked(model: MlpModel, grid: Floats) -> Floats:
    """Return range errors at each node, at equally likely ranks; NaN for no echo."""
    out = np.empty((grid.shape[1], RANKS))
    rank = (np.arange(RANKS) + 0.5) / RANKS
    for start in range(0, len(out), 1024):
        distance, *others = grid[:, start : start + 1024]
        law = model.law(Ping.of(distance, *others))
        echo = law.echo
        which = np.minimum(rank[:, None] / np.maximum(echo, 1e-9), 1.0 - 1e-9)
        reading = law.quantile(which)
        out[start : start + 1024] = np.where(rank[:, None] < echo, reading - distance, np.nan).T
    return out


PATHS: Mapping[str, Callable[[MlpModel], Draw]] = {
    "numpy": numpy_path,
    "torch, eager": torch_path,
    "torch, compiled": lambda model: torch_path(model, compiled=True),
    "numba": numba_path,
    "table": table_path,
}


def disagreement(draw: Draw, model: MlpModel, draws: int, rng: np.random.Generator) -> Floats:
    """Return the distance of a path's readings from the law, at a few conditions between nodes, (conditions,).

    This is the total variation distance between sampled frequencies and exact probabilities, over bins of at least 1 %
    probability, minus its expectation for a correct path.
    """
    distances, angles, reflectances = (0.17, 0.61, 1.43, 2.9, 4.7), (0.02, 0.31), (0.22, 0.83)
    found = []
    for distance, angle, reflectance in product(distances, angles, reflectances):
        ping = Ping.of(np.full(draws, distance), angle, reflectance=reflectance)
        law = model.law(ping[[0]])
        steps = np.arange(1, law.last_step + 1)
        cdf = law.cdf_step(steps[:, None])[:, 0]
        place = np.r_[0, np.minimum((100 * cdf).astype(np.int64), 99) + 1]  # 0 is no echo
        p = np.bincount(place, np.r_[law.no_echo, np.diff(cdf, prepend=0.0)], minlength=101)
        reading = draw(ping, rng)
        drawn = place[np.where(reading.echo, np.rint(reading.range / law.resolution).astype(np.int64), 0)]
        share = np.bincount(drawn, minlength=101) / draws
        by_chance = 0.5 * np.sqrt(2.0 / np.pi * p * (1.0 - p) / draws).sum()
        found.append(0.5 * np.abs(share - p).sum() - by_chance)
    return np.array(found)
