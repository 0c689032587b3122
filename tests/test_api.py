"""The public surface: what docs/reference/python/index.md calls stable, its types, and what a notebook prints of it."""

import inspect
import re
import types
from dataclasses import fields
from enum import Enum
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import acquisition
import noise
import sonar_gym
from acquisition import Ping, Reading, Recording
from acquisition.bench import Rig, Setup, Unit
from noise.faults import Short
from sonar_gym.parking.settings import FleetSettings, ParkingSettings
from sonar_gym.wrappers.settings import SonarSettings

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "python" / "index.md"
PACKAGES = (acquisition, noise, sonar_gym)
LONG, MAX_DEFAULT = type("Long", (), {"__repr__": lambda self: "..."})(), 60  # in place of long defaults
FOREIGN = (  # of Stable-Baselines3
    "close_extras", "env_is_wrapped", "env_method", "get_attr", "seed", "set_attr", "set_options", "step_async",
    "step_wait",
)  # fmt: skip


def plain(signature):
    """Return a signature without annotations and without `self`."""
    given = [p.replace(annotation=p.empty) for p in signature.parameters.values() if p.name not in ("self", "cls")]
    short = [p.replace(default=LONG) if len(repr(p.default)) > MAX_DEFAULT else p for p in given]
    return str(inspect.Signature(short))


def own(cls):
    """Yield the public methods that a class of this project defines."""
    for name, member in inspect.getmembers(cls):
        function = getattr(member, "__func__", member)
        public = name[0] != "_" and name not in FOREIGN and inspect.isfunction(function)
        if public and function.__module__.split(".")[0] in ("acquisition", "noise", "sonar_gym"):
            yield name, inspect.signature(function)


def stable():
    """Yield one line for each name that is stable."""
    for package in PACKAGES:
        for name in sorted(package.__all__):
            thing = getattr(package, name)
            if isinstance(thing, types.ModuleType):
                continue
            if not callable(thing):
                yield f"{package.__name__}.{name}"
            elif inspect.isclass(thing) and issubclass(thing, Enum):
                yield f"{package.__name__}.{name}({', '.join(thing.__members__)})"
            elif inspect.isclass(thing) and issubclass(thing, BaseException):
                yield f"{package.__name__}.{name}({thing.__mro__[1].__name__})"
            else:
                yield f"{package.__name__}.{name}{plain(inspect.signature(thing))}"
            if inspect.isclass(thing) and not issubclass(thing, BaseException | Enum):
                yield from (f"{package.__name__}.{name}.{method}{plain(sig)}" for method, sig in own(thing))


def test_the_stable_names_are_those_of_the_page():
    promised = re.search(r"```text\n(.*?)```", PAGE.read_text(), re.DOTALL)[1].split("\n")[:-1]
    assert promised == list(stable()), "a change of the public surface: change the page and CHANGELOG.md, too"


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_completion_finds_every_name(package):
    assert set(package.__all__) <= set(dir(package))
    assert package.__version__ == acquisition.__version__


def overrides(cls, name):
    """Return whether a method is one of Gymnasium or Stable-Baselines3, whose types it must have."""
    bases = [base for base in cls.__mro__ if base.__module__.split(".")[0] in ("gymnasium", "stable_baselines3")]
    return name != "__init__" and any(name in vars(base) for base in bases)


def functions():
    """Yield name and function of all that is public, except what has the types of another package."""
    for package in PACKAGES:
        for name in package.__all__:
            thing = getattr(package, name)
            if inspect.isfunction(thing):
                yield f"{package.__name__}.{name}", thing
            elif inspect.isclass(thing) and not issubclass(thing, BaseException | Enum):
                properties = [(key, value.fget) for key, value in inspect.getmembers(thing) if type(value) is property]
                methods = [(key, getattr(thing, key)) for key in ("__init__", *(key for key, _ in own(thing)))]
                yield from (
                    (f"{package.__name__}.{name}.{k}", f) for k, f in methods + properties if not overrides(thing, k)
                )


def test_no_public_type_is_any():
    found = {
        f"{name}: {argument}"
        for name, function in functions()
        for argument, hint in getattr(function, "__annotations__", {}).items()
        if re.search(r"\bAny\b", str(hint))
    }
    assert found == set()


@pytest.mark.parametrize(
    ("settings", "cls", "others"),
    [
        (ParkingSettings, sonar_gym.SonarParkingEnv, {"reward", "return"}),
        (FleetSettings, sonar_gym.SonarParkingVectorEnv, {"num_envs", "autoreset_mode", "return"}),
    ],
)
def test_settings_that_are_handed_on_are_those_of_the_environment(settings, cls, others):
    known = {name: hint.__forward_arg__ for name, hint in settings.__annotations__.items()}
    assert known == {name: hint for name, hint in cls.__init__.__annotations__.items() if name not in others}


@pytest.mark.parametrize("cls", [sonar_gym.SonarObservation, sonar_gym.SonarVectorObservation])
def test_the_wrappers_take_the_settings_by_name(cls):
    given = {name: p.default for name, p in inspect.signature(cls).parameters.items() if p.kind is p.KEYWORD_ONLY}
    assert given == {field.name: field.default for field in fields(SonarSettings)}


def test_what_a_notebook_prints_is_short():
    ping = Ping.of(distance=np.linspace(0.3, 3.0, 1000), reflectance=0.9)
    recording = Recording.of(ping, Reading.of(ping.distance), name="a/very/long/path/" * 20)
    env = gymnasium.make("SonarParking-v0", sonar="gaussian")
    every_effect = noise.PhysicalModel([effect() for effect in noise.CATALOGUE.values()])
    models = [*map(noise.load_model, noise.model_names()), every_effect]
    things = [
        *models,
        *(model.law(ping) for model in models if not model.remembers),
        ping,
        Reading.of(ping.distance),
        recording,
        noise.Faulty(models[0], [Short(rate=0.1)]),
        noise.ConditionPrior(),
        noise.CredenceTable.of(noise.load_model("gaussian")),
        Unit.draw(1),
        Setup.draw(1),
        Rig(),
        env,
        env.unwrapped,
        gymnasium.make_vec("SonarParking-v0", num_envs=2, sonar="gaussian"),
        sonar_gym.SonarObservation(env, "gaussian"),
        sonar_gym.SonarVecEnv(2, sonar="gaussian"),
        sonar_gym.Curriculum("easy", "hard"),
        sonar_gym.ParkingDriver(),
        sonar_gym.load_agent("parking"),
        sonar_gym.run_episode(env, sonar_gym.load_agent("parking"), seed=0),
    ]
    assert {type(thing).__name__: len(repr(thing)) for thing in things if len(repr(thing)) > 200} == {}


def test_a_notebook_shows_a_recording_as_a_table():
    recording = Recording.of(Ping.of(distance=[1.0, 2.0]), Reading.of([1.0, 0.0]), name="<b>")
    html = recording._repr_html_()
    assert html.startswith("<p>&lt;b&gt;: 2 pings")
    assert "<table" in html
    assert recording.summary() == (
        "<b>: 2 pings, 2 conditions, 1 to 2 m, 50.0 % echoes, 0.0 % no answer; columns time_s, session, sensor, "
        "distance_mm, angle_deg, incidence_deg, reflectance, reading_mm"
    )


def test_a_recording_is_drawn(tmp_path):
    recording = Recording.of(Ping.of(distance=[1.0, 2.0]), Reading.of([1.0, 0.0]))
    recording.plot().savefig(tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes()[:4] == b"\x89PNG"


def test_recordings_are_accepted_in_every_form(tmp_path):
    recording = Recording.of(Ping.of(distance=[1.0, 2.0]), Reading.of([1.0, 0.0]))
    path = recording.save(tmp_path / "rec.csv")
    for given in (recording, recording.table, path, str(path)):
        assert np.array_equal(acquisition.as_recording(given).reading.range, recording.reading.range)
    with pytest.raises(acquisition.SettingError, match="is a list, expected a Recording, a DataFrame or the path"):
        acquisition.as_recording([1, 2])
