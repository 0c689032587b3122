"""The formula of each effect in LaTeX, and an example that shows what the effect does to readings.

Symbols: r range that the register holds, s length of a path (half the way of the sound), d distance, L level above the
threshold in dB, t time, P probability, theta incidence, beta bearing; primes mark values after the effect.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Axis = Literal["distance", "angle", "reflectance", "time"]


@dataclass(frozen=True)
class Example:
    """Formula and example of an effect.

    Attributes:
        formula: in LaTeX.
        values: parameters of the example.
        axis: condition that varies in the figure.
        beside: other effects of the sonar in the figure, with their parameters.
        facing: whether reflectors at any bearing face the sensor.
    """

    formula: str
    values: Mapping[str, float]
    axis: Axis = "distance"
    beside: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    facing: bool = False


def weak(loss_db: float) -> dict[str, dict[str, float]]:
    """Return a loss of level, dB, that brings echoes near the threshold."""
    return {"sensitivity": {"loss_db": loss_db}}


EXAMPLES = {
    "sound_speed": Example(
        r"s' = s \, \frac{c(T_0)}{c(T)}, \quad c(T) = 331.3 \sqrt{1 + T / 273.15}", {"temperature_c": 0.0}
    ),
    "thermal_drift": Example(
        r"T(t) = T + \dot T t + a \sin\frac{2 \pi t}{\tau} + b \cos\frac{2 \pi t}{\tau}",
        {"sine_k": 8.0, "period_s": 3600.0},
        "time",
    ),
    "air_absorption": Example(r"L' = L - 2 \alpha s", {"alpha_db_per_m": 1.5}, beside=weak(40.0)),
    "scintillation": Example(
        r"L' \sim N(L, \sigma^2), \quad \sigma = \sigma_6 (s / 6)^{11/12}", {"sigma_at_6m_db": 8.0}, beside=weak(45.0)
    ),
    "beam_width": Example(
        r"L' = L + 40 \log_{10} \frac{2 J_1(x)}{x}, \quad x = k a \sin \beta",
        {"ka": 9.0},
        "angle",
        weak(25.0),
        facing=True,
    ),
    "boresight": Example(
        r"\beta' = \beta - \psi", {"yaw_deg": 10.0}, "angle", {**weak(25.0), "beam_width": {"ka": 9.0}}, facing=True
    ),
    "pivot_offset": Example(r"d' = d + e (1 - \cos \beta) + f \sin \beta", {"axial_m": 0.3}, "angle"),
    "baseline_parallax": Example(r"s = \sqrt{d^2 + (b / 2)^2}", {"spacing_m": 0.2}),
    "ray_cone": Example(
        r"s = \min_{|\alpha| \leq \alpha_0} \frac{d \cos\theta}{\cos(\alpha - \beta + \theta)}",
        {"half_deg": 15.0, "half_width_m": 0.3},
        "angle",
        facing=True,
    ),
    "zero_offset": Example(r"r' = r + b", {"offset_m": 0.05}),
    "reflectance_loss": Example(r"L' = L + k \, 20 \log_{10} R", {"strength": 1.0}, "reflectance", weak(45.0)),
    "specular_loss": Example(
        r"L' = L - k J(\nu), \quad \nu = (d \sin\theta - a) \sqrt{4 / (\lambda d)}",
        {"strength": 1.0},
        "angle",
        weak(25.0),
    ),
    "edge_diffraction": Example(
        r"s = \sqrt{d^2 + a^2 - 2 d a \sin\theta}, \quad L = L_1 - 33\,\mathrm{dB}", {"presence": 1.0}, "angle"
    ),
    "perpendicular_foot": Example(r"s' = (1 - k) s + k s \cos\theta", {"share": 1.0, "half_width_m": 1.0}, "angle"),
    "background_reflector": Example(
        r"s = d + h, \quad L = L_1 - \Delta", {"presence": 1.0, "behind_m": 0.5, "loss_db": -10.0}, beside=weak(45.0)
    ),
    "fixed_clutter": Example(r"s \sim N(s_0, \sigma^2)", {"presence": 0.3, "range_m": 3.25, "spread_m": 0.02}),
    "multipath": Example(
        r"s = \tfrac12 \left(\sqrt{d^2 + 4 h^2} + d\right)",
        {"presence": 1.0, "height_m": 0.5, "loss_db": 0.0},
        beside=weak(45.0),
    ),
    "repeated_bounce": Example(
        r"s = 2 d, \quad L = L_1 - \Delta",
        {"presence": 1.0, "loss_db": 0.0},
        beside={"rearm_dead_time": {"deaf_m": 1.0}},
    ),
    "ring_down": Example(r"P(r > z) = e^{-(z - z_0) / \delta}", {"probability": 0.3, "range_m": 0.1, "decay_m": 0.1}),
    "previous_ping": Example(r"s = s_f + n \, d' - c \, \Delta t / 2", {"presence": 0.5, "far_m": 12.0}),
    "synchronous_crosstalk": Example(r"s = \tfrac12 (d + d_o)", {"presence": 0.5, "other_m": 1.0}),
    "asynchronous_crosstalk": Example(
        r"s = \tfrac12 c \, (t_1 + k \tau - t)", {"presence": 0.5, "period_s": 0.0713, "spread_m": 0.1}
    ),
    "sensitivity": Example(r"L' = L - \Delta", {"loss_db": 55.0}),
    "travel_time_jitter": Example(r"\sigma'^2 = \sigma^2 + \sigma_0^2 + (k s)^2", {"sigma_m": 0.01, "per_metre": 0.01}),
    "time_walk": Example(
        r"s' = s + k \, w(L), \quad \sigma'^2 = \sigma^2 + \tfrac14 k^2 \, (w(L - \sigma_L) - w(L + \sigma_L))^2",
        {"scale": 1.0},
        beside=weak(45.0),
    ),
    "cycle_slip": Example(r"P(k) \propto p^k, \quad s' = s + k \lambda / 2", {"probability": 0.4}),
    "rearm_dead_time": Example(r"s < s_0 \Rightarrow \text{lost}", {"deaf_m": 1.0}),
    "false_alarm": Example(r"P(\text{none before } z) = e^{-\lambda (z - z_0)}", {"per_metre": 0.05}),
    "quantisation": Example(r"r' = q \left\lfloor r / q + \tfrac12 \right\rfloor", {"step_m": 0.2}),
    "truncation": Example(r"r' = q \left\lfloor r / q \right\rfloor", {"step_m": 0.2}),
    "range_gate": Example(r"s > s_g \Rightarrow \text{lost}", {"listen_m": 4.0}),
    "clock_scale": Example(r"r' = (1 + \epsilon) \, r", {"error": 0.03}),
    "warm_up": Example(r"r' = r + b \, e^{-t / \tau}", {"offset_m": 0.05, "tau_s": 600.0}, "time"),
    "latency": Example(r"d'(t) = d(t - \tau) \approx d - \tau \, \dot d", {"delay_s": 0.3}),
    "dropped_reading": Example(r"P(\text{no echo}) = p + (1 - p) P_0(\text{no echo})", {"probability": 0.3}),
    "stale_repeat": Example(r"P(r_i = r_{i-1}) = p", {"probability": 0.3}),
    "stuck": Example(r"P(r = v) = p", {"probability": 0.3, "value_m": 1.0}),
    "spike": Example(r"P(r \sim U(0, z)) = p", {"probability": 0.1, "span_m": 8.0}),
    "noise_burst": Example(r"P(r \sim N(r_0, \sigma^2)) = p", {"probability": 0.3, "sigma_m": 0.2}),
    "corrupted_byte": Example(r"r' = u \, (n \oplus 2^k), \quad n = r / u", {"probability": 0.3, "unit_m": 0.01}),
}
