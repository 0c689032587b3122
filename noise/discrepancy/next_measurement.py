"""What to measure next: the condition under which surviving explanations predict the most different readings.

Conditions are those a user can set: distance, angle, the receiver's gain, the time between pings. Everything that a
setting does to the physics it does under every explanation; what counts is the Kullback-Leibler divergence between
the predicted laws, per ping, each ping at a newly placed target.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from acquisition import Ping, Reading
from noise.cells import FLOOR, alone
from noise.discrepancy.rivals import SETTLED
from noise.law import EchoLaw, Floats
from noise.stack import Stack

DISTANCES = np.array([0.15, 0.25, 0.4, 0.6, 0.9, 1.3, 1.8, 2.5, 3.5, 4.5, 6.0])
ANGLES_DEG = np.array([-20.0, 0.0, 5.0, 10.0, 20.0, 30.0])
SPEED_HALF = 172.0  # m/s; range per second of delay
DRAWS = 60
HOPELESS = 0.004  # nats per ping: thousands of pings; not worth proposing
TOGETHER = 5  # conditions proposed at once, so that no single misplaced target decides
DEG = np.pi / 180.0


@dataclass(frozen=True)
class Measurement:
    """A measurement worth making.

    Attributes:
        do: in plain English.
        separates: the effects that it tells apart.
        pings: to 10.8 nats (99 %).
    """

    do: str
    separates: tuple[str, ...]
    pings: int


def _as_is(stack: Stack) -> Stack:
    return stack


def _more_gain(stack: Stack) -> Stack:
    loss = stack.get(("sensitivity", "loss_db"))
    return stack.put([("sensitivity", "loss_db")], [max(loss - 6.0, 0.0)])


def _less_gain(stack: Stack) -> Stack:
    return stack.put([("sensitivity", "loss_db")], [stack.get(("sensitivity", "loss_db")) + 6.0])


def _later_ping(stack: Stack) -> Stack:
    if "previous_ping" not in stack.values:
        return stack
    key = ("previous_ping", "far_m")
    return stack.put([key], [stack.get(key) - 0.005 * SPEED_HALF])


# what can be set, besides where the target stands: words, and what it changes under every explanation
SETTINGS: dict[str, Callable[[Stack], Stack]] = {
    "": _as_is,
    ", with 6 dB more receiver gain": _more_gain,
    ", with 6 dB less receiver gain": _less_gain,
    ", with 5 ms more between pings": _later_ping,
}
# what the laws cannot tell because it is no condition of a ping: read it off another instrument
OTHER_INSTRUMENT = {
    frozenset({"sound_speed", "clock_scale"}): "read a thermometer beside the sensor (sound_speed says {temperature})",
    frozenset({"thermal_drift", "sound_speed"}): "log a thermometer beside the sensor through the whole session",
    frozenset({"thermal_drift", "warm_up"}): "log a thermometer, and start a second session with the sensor still warm",
    frozenset({"thermal_drift", "clock_scale"}): "log a thermometer beside the sensor through the whole session",
}


def next_measurement(
    own: Stack, rivals: Sequence[tuple[str, str, Stack]], seed: int, simulation: Stack | None = None
) -> list[Measurement]:
    """Return the measurements that tell surviving rivals apart, each once.

    Args:
        own: the explanation.
        rivals: (chosen effect, rival effect, rival explanation) of each that survives.
        seed: of the draws.
        simulation: the law that stands for a simulation whose own temperature nobody stated; None where 22.8 degC is
            what the sensor assumes.
    """
    return merged([_separate(own, stack, chosen, rival, seed, simulation) for chosen, rival, stack in rivals])


def merged(measurements: Sequence[Measurement]) -> list[Measurement]:
    """Return measurements with those that ask for the same thing made one."""
    out: dict[str, Measurement] = {}
    for m in measurements:
        same = out.get(m.do, Measurement(m.do, (), 0))
        out[m.do] = Measurement(m.do, tuple(dict.fromkeys((*same.separates, *m.separates))), max(same.pings, m.pings))
    return list(out.values())


def _separate(own: Stack, other: Stack, chosen: str, rival: str, seed: int, simulation: Stack | None) -> Measurement:
    pair = frozenset({chosen, rival})
    if pair in OTHER_INSTRUMENT:
        warm = (own if chosen == "sound_speed" else other).get(("sound_speed", "temperature_c"))
        return Measurement(OTHER_INSTRUMENT[pair].format(temperature=_warmth(warm, simulation)), (chosen, rival), 1)
    ping = grid()
    best = max(((*divergence(own, other, ping, change, seed), words) for words, change in SETTINGS.items()), key=_first)
    value, rows, words = best
    if value < HOPELESS:
        text = "no distance, angle, gain or ping interval tells these apart: inspect the sensor and its link instead"
        return Measurement(text, (chosen, rival), 0)
    return Measurement(_tell(ping[rows]) + words, (chosen, rival), int(np.ceil(SETTLED / value)))


def _warmth(celsius: float, simulation: Stack | None) -> str:
    if simulation is None:
        return f"{celsius:.1f} degC"
    more = celsius - simulation.get(("sound_speed", "temperature_c"))
    return f"{abs(more):.0f} K {'warmer' if more > 0 else 'colder'} than the simulation has it"


def _first(item: tuple[float, object, str]) -> float:
    return item[0]


def grid() -> Ping:
    """Return the conditions that are considered."""
    distance, angle = np.meshgrid(DISTANCES, ANGLES_DEG * DEG, indexing="ij")
    return Ping.of(distance=distance.ravel(), angle=angle.ravel())


def divergence(
    own: Stack, other: Stack, ping: Ping, change: Callable[[Stack], Stack], seed: int
) -> tuple[float, np.ndarray]:
    """Return nats per ping between two explanations, averaged over the best conditions, and which those are."""
    repeated = ping[np.repeat(np.arange(len(ping)), DRAWS)]
    laws = [_law(change(stack), repeated) for stack in (own, other)]
    total = np.zeros(len(ping))
    for k, law in enumerate(laws):
        reading = law.sample(np.random.default_rng([seed, k]))
        ratio = floored(law, reading) - floored(laws[1 - k], reading)
        total += ratio.reshape(len(ping), DRAWS).mean(axis=1) / 2.0
    rows = np.argsort(-total)[:TOGETHER]
    return float(total[rows].mean()), rows


def _law(stack: Stack, ping: Ping) -> EchoLaw:
    model, cells = stack.build()
    return alone(model.law(ping), cells)


def floored(law: EchoLaw, reading: Reading) -> Floats:
    """Return log probabilities with the floor of arbitrary readings and silences in them, nats, (n,)."""
    return np.log((1.0 - 2.0 * FLOOR) * np.exp(law.log_prob(reading)) + FLOOR * np.where(reading.echo, 1e-4, 1.0))


def _tell(ping: Ping) -> str:
    distance, angle = np.unique(ping.distance), np.unique(np.rint(ping.angle / DEG))
    metres = _span(distance, "m", "g")
    return f"place the target at {metres} and {_span(angle, 'deg', '.0f')}"


def _span(value: Floats, unit: str, style: str) -> str:
    low, high = format(value.min(), style), format(value.max(), style)
    return f"{low} {unit}" if low == high else f"{low} to {high} {unit}"
