"""Receiver effects: threshold, detection, clock and register."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from scipy.optimize import brentq
from torch import Tensor

from noise.effects.base import EchoSample, Effect, Parameter, Stage
from noise.effects.state import Clutter, Path, State, interpolate, number

GATE_MARGIN_M = 0.02  # distance of an initial gate beyond the farthest echo; chosen here
MAX_NOISE_PER_M = 20.0  # false alarms per metre; chosen here
HALF_WAVE = 4.29e-3  # m; one period of 40 kHz as range, 25 us at 343.4 m/s there and back
MAX_STEP_M = 0.2  # of a register; a sonar with coarser steps is no range finder

# Lag of the threshold crossing after the start of the echo, as range, by the level of its peak above the threshold:
# 8 cycles of 40 kHz through two resonators of 2 kHz width at -6 dB, first crossing of one polarity.
WALK_DB = (0.2, 1.0, 2.0, 3.0, 4.0, 6.0, 9.0, 12.0, 16.0, 20.0, 30.0, 40.0)
WALK_M = (0.061, 0.048, 0.044, 0.0395, 0.035, 0.031, 0.0265, 0.022, 0.018, 0.0135, 0.009, 0.0047)


class Sensitivity(Effect):
    """Every echo is `loss_db` weaker relative to the threshold than in an ideal sonar: level -> level - loss."""

    name = "sensitivity"
    stage = Stage.MEDIUM
    summary = "The receiver is less sensitive than an ideal one: echoes near its threshold are missed"
    parameters = (
        Parameter(
            "loss_db", "dB", 0.0, 0.0, 80.0, "SRF08 gain table; units differ by 3 to 6 dB", (30.0, 40.0, 50.0),
            typical=6.0, adds=True,
        ),
    )  # fmt: skip
    loss_db: Tensor

    def apply(self, state: State) -> State:
        """Lower the level of every path."""
        return state.map_paths(lambda path: replace(path, level_db=path.level_db - self.loss_db))

    def statement(self) -> str:
        """Return a sentence with the loss."""
        loss = self.values["loss_db"]
        if loss < 0.0:
            return f"The receiver is {-loss:.2g} dB more sensitive: it hears weaker echoes."
        return f"The receiver is {loss:.2g} dB less sensitive: it misses weak echoes."


class ClockScale(Effect):
    """Relative error of the timer, or of the constant from time to range: register = (1 + error) * range."""

    name = "clock_scale"
    stage = Stage.REGISTER
    summary = "The sensor's clock, or its constant from time to range, has an error: all ranges are scaled"
    parameters = (
        Parameter(
            "error",
            "1",
            0.0,
            -0.05,
            0.05,
            "resonators +-0.5 %; unit constants: chosen here",
            (0.0,),
            typical=0.01,
            adds=True,
        ),
    )
    error: Tensor

    def apply(self, state: State) -> State:
        """Scale the register."""
        factor = 1.0 + self.error
        return replace(state, scale=state.scale * factor, offset=state.offset * factor)

    def statement(self) -> str:
        """Return a sentence with the relative error."""
        error = self.values["error"]
        sense = "long" if error >= 0 else "short"
        return f"Readings run {sense} by {100 * abs(error):.2g} % of distance: the clock or its constant has an error."


class ZeroOffset(Effect):
    """The reference plane of ranges differs from that of distances: register = range + offset."""

    name = "zero_offset"
    stage = Stage.REGISTER
    summary = "The reference plane of ranges differs from that of distances: all ranges have the same offset"
    parameters = (
        Parameter(
            "offset_m", "m", 0.0, -0.5, 0.5, "mounting +-30 mm; from a robot's origin: chosen here", (0.0,),
            typical=0.015, adds=True,
        ),
    )  # fmt: skip
    offset_m: Tensor

    def apply(self, state: State) -> State:
        """Shift the register."""
        return replace(state, offset=state.offset + self.offset_m)

    def statement(self) -> str:
        """Return a sentence with the offset."""
        shift = f"All ranges have an offset of {1000 * self.values['offset_m']:+.1f} mm"
        return f"{shift}: their reference plane differs from that of the distances."


class TravelTimeJitter(Effect):
    """Arrivals scatter from ping to ping: spread^2 -> spread^2 + sigma^2 + (per_metre * length)^2."""

    name = "travel_time_jitter"
    stage = Stage.DETECTOR
    summary = "Readings scatter from ping to ping"
    parameters = (
        Parameter("sigma_m", "m", 0.0, 0.0, 0.2, "electronic noise on the echo's slope: chosen here", (0.003,)),
        Parameter("per_metre", "1", 0.0, 0.0, 0.1, "thermal eddies 0.1 to 1 mm at 6 m; wider: chosen here", (0.001,)),
    )
    sigma_m: Tensor
    per_metre: Tensor

    def apply(self, state: State) -> State:
        """Widen every path."""
        return state.map_paths(lambda path: path.widened(self.sigma_m**2 + (self.per_metre * path.length) ** 2))

    def statement(self) -> str:
        """Return a sentence with the scatter and its growth with distance."""
        v = self.values
        return f"{self.summary}, by {1000 * v['sigma_m']:.2g} mm and by {1000 * v['per_metre']:.2g} mm per metre."


class TimeWalk(Effect):
    """A weak echo crosses the threshold later: lag -> lag + scale table(level); scale 1 is an SRF08 of 2 kHz width.

    What scatters the level scatters the lag too, by the slope of the table over that scatter: most for weak echoes.
    """

    name = "time_walk"
    stage = Stage.DETECTOR
    summary = "Weak echoes cross the threshold late: their readings are too long"
    parameters = (
        Parameter(
            "scale", "1", 0.0, 0.0, 2.5, "0.85 (2.6 kHz) to 1.35 (1.2 kHz); wider: chosen here", (1.0,), typical=0.25
        ),
    )
    scale: Tensor

    def apply(self, state: State) -> State:
        """Delay every path by its level, whose scatter from ping to ping scatters the delay."""
        weight, width = torch.softmax(state.log_weight, dim=0), state.width_db

        def late(level_db: Tensor) -> Tensor:
            return self.scale * interpolate(level_db, WALK_DB, WALK_M)

        def delay(path: Path) -> Path:
            level = torch.maximum(path.level_db, width)  # what is heard is above the threshold
            change = 0.5 * (late(level - width) - late(level + width))
            scatter = torch.sqrt((weight * change**2).sum(dim=0) + 1e-18)  # finite gradient at zero
            return replace(path, lag=path.lag + late(path.level_db), walk=scatter / width).widened(scatter**2)

        return state.map_paths(delay)

    def statement(self) -> str:
        """Return a sentence with the lag at two levels."""
        scale = 1000 * self.values["scale"]
        return f"{self.summary}, by {13.5e-3 * scale:.0f} mm at 20 dB above it and {44e-3 * scale:.0f} mm at 2 dB."


class CycleSlip(Effect):
    """The first, second or third cycle of an echo triggers the detector: a comb of readings 4.29 mm apart."""

    name = "cycle_slip"
    stage = Stage.DETECTOR
    summary = "Echoes are detected one or two cycles late: readings form a comb 4.29 mm apart"
    coarsest_step_m = HALF_WAVE
    parameters = (Parameter("probability", "1", 0.0, 0.0, 0.9, "of each further cycle; chosen here", (0.3,)),)
    probability: Tensor

    def apply(self, state: State) -> State:
        """Add detection points one and two cycles late."""
        p = self.probability
        slip_m = number([0.0, HALF_WAVE, 2.0 * HALF_WAVE])
        weight = torch.stack([1.0 - p, p * (1.0 - p), p * p])
        return state.map_paths(lambda path: replace(path, slip_m=slip_m, slip_weight=weight))

    def statement(self) -> str:
        """Return a sentence with the probability."""
        return f"{self.summary}, {100 * self.values['probability']:.3g} % of echoes late."


class RearmDeadTime(Effect):
    """After a burst the comparator is blind until it is re-armed: arrivals from nearer than `deaf_m` are lost.

    This is not a lower limit of the reading: later arrivals by longer paths are detected.
    """

    name = "rearm_dead_time"
    stage = Stage.DETECTOR
    localised = True
    summary = "The receiver is re-armed late: near echoes are lost"
    parameters = (
        Parameter("deaf_m", "m", 0.0, 0.0, 1.2, "blanking 150-500 us, re-arming 1-4 ms: 0.03 to 0.7 m", (0.12, 0.5)),
    )
    deaf_m: Tensor

    def apply(self, state: State) -> State:
        """Set the blind range."""
        return replace(state, blind_range=self.deaf_m)

    def statement(self) -> str:
        """Return a sentence with the blind range."""
        return f"The receiver is re-armed late: echoes from nearer than {100 * self.values['deaf_m']:.0f} cm are lost."


class FalseAlarm(Effect):
    """Noise crosses the threshold at a constant rate during the listening window; observable only before the echo.

    Intermittent noise (compressed air, keys) occurs in a `share` of the pings, then with rate `per_metre`. The start
    `from_m` has no useful derivative, since the likelihood jumps at every reading: a fit must start just before the
    first false alarm.
    """

    name = "false_alarm"
    stage = Stage.DETECTOR
    localised = True
    by_ping = True
    summary = "Noise is taken for an echo before the true echo arrives"
    parameters = (
        Parameter(
            "per_metre",
            "1/m",
            0.0,
            0.0,
            MAX_NOISE_PER_M,
            "1e-5 to 1e-2 a ping; with air noise: chosen here",
            (0.005, 1.0),
            adds=True,
        ),
        Parameter("share", "1", 1.0, 0.01, 1.0, "of pings with noise: chosen here", (1.0, 0.3)),
        Parameter("from_m", "m", 0.0, 0.0, 1.0, "start of sensitive listening: chosen here", (0.0, 0.3), jumps=True),
    )
    per_metre: Tensor
    share: Tensor
    from_m: Tensor

    def apply(self, state: State) -> State:
        """Add false detections."""
        return replace(state, clutter=Clutter(self.per_metre, self.share, self.from_m.detach()))

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return noise from the first early reading on: intermittent with the observed decay, and in all pings."""
        early = echoes.early.range
        if len(early) < 4:
            return []
        begun = float(np.clip(early.min() - 0.01, 0.0, 1.0))
        before = np.maximum(0.9 * echoes.distance - 0.05 - begun, 0.0)

        def expected(rate: float) -> float:
            return float(-np.expm1(-rate * before).sum())

        steep = float(np.clip(np.log(2.0) / max(np.median(early) - begun, 0.02), 0.0, MAX_NOISE_PER_M))
        share = float(np.clip(len(early) / max(expected(steep), 1.0), 0.01, 1.0))
        out = [{"per_metre": steep, "share": share, "from_m": begun}]
        if expected(MAX_NOISE_PER_M) > len(early):
            rate = float(brentq(lambda each: expected(each) - len(early), 0.0, MAX_NOISE_PER_M))
            out.append({"per_metre": rate, "share": 1.0, "from_m": begun})
        return out

    def statement(self) -> str:
        """Return a sentence with the rate and the share of pings."""
        v = self.values
        text = f"{self.summary}, in {-100 * np.expm1(-v['per_metre']):.2g} % of pings per metre of listening"
        when = "" if v["share"] == 1.0 else f" during noise, which occurs in {100 * v['share']:.2g} % of pings"
        return f"{text}{when}."


def _steps_of(echoes: EchoSample) -> list[dict[str, float]]:
    return [{"step_m": echoes.grid_m}] if 0.0 < echoes.grid_m <= MAX_STEP_M else []


class Quantisation(Effect):
    """The reading is rounded to whole steps, such as centimetres. The step has no derivative: fits try the starts."""

    name = "quantisation"
    stage = Stage.REGISTER
    summary = "Readings have coarse steps"
    parameters = (
        Parameter(
            "step_m", "m", 0.0, 0.0, MAX_STEP_M, "cm or inch output, Devantech SRF08", (0.01, 0.0254), jumps=True
        ),
    )
    step_m: Tensor

    def apply(self, state: State) -> State:
        """Round the register."""
        return replace(state, step=float(self.step_m.detach()))

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return the step on whose multiples all readings lie."""
        return _steps_of(echoes)

    def statement(self) -> str:
        """Return a sentence with the step."""
        return f"{self.summary} of {1000 * self.values['step_m']:.1f} mm."


class Truncation(Effect):
    """The reading is truncated to whole steps by integer division: step floor(range / step), half a step short."""

    name = "truncation"
    stage = Stage.REGISTER
    summary = "Readings are truncated to whole steps"
    parameters = (
        Parameter(
            "step_m", "m", 0.0, 0.0, MAX_STEP_M, "integer division to cm or inch, us / 58", (0.01, 0.0254), jumps=True
        ),
    )
    step_m: Tensor

    def apply(self, state: State) -> State:
        """Round to the step after a shift by half a step."""
        step = self.step_m.detach()
        return replace(state, step=max(state.step, float(step)), offset=state.offset - step / 2.0)

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return the step on whose multiples all readings lie."""
        return _steps_of(echoes)

    def statement(self) -> str:
        """Return a sentence with the step and the mean error."""
        step = 1000 * self.values["step_m"]
        return f"{self.summary} of {step:.1f} mm: they run short by {step / 2:.1f} mm on average."


class RangeGate(Effect):
    """The listening window ends early: echoes from beyond `listen_m` are not detected."""

    name = "range_gate"
    stage = Stage.REGISTER
    localised = True
    summary = "The listening window ends early: farther echoes are not detected"
    parameters = (
        Parameter(
            "listen_m",
            "m",
            11.008,
            0.3,
            11.008,
            "range register (r + 1) 43 mm, Devantech SRF08",
            (6.0, 3.0),
            jumps=True,
        ),
    )
    listen_m: Tensor

    def apply(self, state: State) -> State:
        """Limit the listening window."""
        return replace(state, gate=torch.minimum(state.gate, self.listen_m))

    def statement(self) -> str:
        """Return a sentence with the end of the window."""
        return f"The listening window ends early: echoes from beyond {self.values['listen_m']:.2f} m are not detected."

    @classmethod
    def guesses(cls, echoes: EchoSample) -> list[dict[str, float]]:
        """Return gates just beyond the farthest echoes, with and without outliers."""
        if len(echoes.range) == 0:
            return []
        return [{"listen_m": float(np.quantile(echoes.range, share)) + GATE_MARGIN_M} for share in (1.0, 0.98)]


class WarmUp(Effect):
    """The zero drifts after power-on: register = range + offset exp(-t / tau), t from the recording's start."""

    name = "warm_up"
    stage = Stage.REGISTER
    needs_time = by_clock = True
    summary = "The zero drifts while the sensor warms up"
    parameters = (
        Parameter("offset_m", "m", 0.0, -0.1, 0.1, "chosen here", (0.01, -0.01), typical=0.01, adds=True),
        Parameter("tau_s", "s", 600.0, 5.0, 7200.0, "5 to 20 min; wider: chosen here", (60.0, 600.0), decays=True),
    )
    offset_m: Tensor
    tau_s: Tensor

    def apply(self, state: State) -> State:
        """Shift the register by the remaining drift."""
        return replace(state, offset=state.offset + self.offset_m * torch.exp(-state.conditions.time / self.tau_s))

    def statement(self) -> str:
        """Return a sentence with the initial offset and the time constant."""
        v = self.values
        return f"{self.summary}, from {1000 * v['offset_m']:+.1f} mm with a time constant of {v['tau_s']:.0f} s."
