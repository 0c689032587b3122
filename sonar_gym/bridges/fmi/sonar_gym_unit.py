"""The sonars of a unit of FMI 3.0. `build` copies this file into the unit, whose importer runs it.

In each step every sonar pings once, at the begin of the step: the inputs are what it faces, the outputs what it reads.
The importer's process needs Python with sonar-gym; the model travels with the unit.
"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pythonfmu3 import Float64, Fmi3Slave, Fmi3StepResult, Int64, Unit
from pythonfmu3.enums import Fmi3Causality, Fmi3Initial, Fmi3Status, Fmi3Variability

from acquisition import SonarError
from acquisition.limits import SEEDS, check_number
from noise import load_model
from sonar_gym.bridges.server.protocol import CONDITIONS, checked_pings
from sonar_gym.bridges.server.sensors import Sensors

SETTINGS, MODEL = "sonar.json", "model"


class Quantity(NamedTuple):
    """An input or output of each sonar."""

    unit: str | None
    start: float
    meaning: str


INPUTS = {
    "distance": Quantity("m", 1000.0, "true distance; 1000 if nothing is in the beam"),
    "bearing": Quantity("rad", 0.0, "of the reflector off the beam axis"),
    "incidence": Quantity("rad", 0.0, "between beam and surface normal"),
    "reflectance": Quantity(None, 0.5, "0..1"),
}
OUTPUTS = {
    "range": Quantity("m", 0.0, "what the sonar reads; 0 without an echo"),
    "status": Quantity(None, 0.0, "0 no echo, 1 echo, 2 no answer"),
    "credence": Quantity(None, 0.0, "probability that the reading is within 10 % of the true distance"),
}


class SonarUnit(Fmi3Slave):
    """Sonars with one model; `distance[1]` is an input of the first, `range[1]` its output."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        resources = Path(self.resources)
        settings = json.loads((resources / SETTINGS).read_text())
        self._n, self.seed, self.time = int(settings["sensors"]), 0, 0.0
        self._sensors = Sensors(load_model(resources / MODEL), float(settings["max_range"]), self.seed)
        self.description = f"{self._n} sonars up to {settings['max_range']:g} m"
        self._values = {name: np.full(self._n, q.start) for name, q in (INPUTS | OUTPUTS).items()}
        self._register()

    def _register(self) -> None:
        self.register_units([Unit("m", m=1), Unit("rad", rad=1), Unit("s", s=1)])
        fixed = {"causality": Fmi3Causality.parameter, "variability": Fmi3Variability.fixed}
        self.register_variable(Float64("time", causality=Fmi3Causality.independent, unit="s"))
        self.register_variable(Int64("seed", description="of the random numbers", **fixed))
        for name, quantity in INPUTS.items():
            self._register_each(name, quantity, causality=Fmi3Causality.input)
        for name, quantity in OUTPUTS.items():
            self._register_each(name, quantity, causality=Fmi3Causality.output, initial=Fmi3Initial.exact)

    def _register_each(self, name: str, quantity: Quantity, **kind: Any) -> None:
        kind |= {"variability": Fmi3Variability.discrete, "unit": quantity.unit, "description": quantity.meaning}
        for k in range(self._n):
            access = {"getter": partial(self._get, name, k), "setter": partial(self._set, name, k)}
            self.register_variable(Float64(f"{name}[{k + 1}]", **kind, **access))

    def _get(self, name: str, sensor: int) -> float:
        return float(self._values[name][sensor])

    def _set(self, name: str, sensor: int, value: float) -> None:
        self._values[name][sensor] = value

    def exit_initialization_mode(self) -> None:
        """Begin anew with the random numbers of the seed."""
        check_number("seed", self.seed, SEEDS, whole=True)
        self._sensors.restart(self.seed)

    def do_step(self, current_time: float, step_size: float) -> Fmi3StepResult:
        """Ping once with every sonar."""
        self.time = current_time
        try:
            self._ping(current_time)
        except SonarError as error:
            self.log(str(error), Fmi3Status.error)
            return Fmi3StepResult(status=Fmi3Status.error)
        return Fmi3StepResult()

    def _ping(self, time_s: float) -> None:
        faced = {**self._values, "time": np.full(self._n, time_s), "sensor": np.arange(self._n, dtype=np.float64)}
        rows = np.stack([faced[name] for name in CONDITIONS], axis=1)
        reading, credence = self._sensors.answer(checked_pings(rows, []))
        self._values |= {"range": reading.range, "status": reading.status.astype(np.float64), "credence": credence}
