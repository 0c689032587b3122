"""One valid call of every public function, from which wrong ones are made."""

import inspect
import warnings
from pathlib import Path

import gymnasium
import numpy as np

import noise
import sonar_gym
from acquisition import Ping, Reading, Recording, as_recording, previous
from acquisition.bench import Rig, Setup, Unit
from noise.beam import BeamModel
from noise.credence import wilson
from noise.effects import Conditions
from noise.faults import Constant, Short
from noise.metrics import crps, evaluate, pit
from sonar_gym.bridges.opendlv import decode, encode
from sonar_gym.bridges.opendlv.messages import READING
from sonar_gym.bridges.opendlv.rec import read_rec, recording_of, write_rec
from sonar_gym.bridges.opendlv.session import time_of
from sonar_gym.bridges.opendlv.walls import load_map
from sonar_gym.bridges.ros.hearing import HeardRanges, scan_sectors
from sonar_gym.bridges.ros.messages import ideal_distances, range_values
from sonar_gym.bridges.server import protocol
from sonar_gym.bridges.server.client import SonarClient
from sonar_gym.bridges.server.server import ServerSettings, SonarServer
from sonar_gym.sensing.mounts import LAYOUTS
from tests.fuzz.conftest import recording

PING, READ, REC = Ping.of([1.0, 2.0]), Reading.of([1.0, 0.0]), recording(24)
ROWS, STEPS, EDGES = np.ones(2), np.full(2, 3), np.linspace(0.0, 3.0, 4)
WALLS = "-1,-1,1,-1;\n1,-1,1,1;\n"


def models():
    """Return one model of each kind."""
    plain, gaussian = noise.PhysicalModel([noise.CATALOGUE["zero_offset"]()]), noise.GaussianModel()
    made = {name: noise.load_model(name) for name in noise.model_names()}
    made |= {"physical": plain, "beam": BeamModel(), "composed": noise.ComposedModel(gaussian, plain.effects, ())}
    return made | {"faulty": noise.Faulty(made["srf08-lstm"], [Short(0.1), Constant(0.1, 1.0)])}


def calls_of_laws(made):
    """Yield name, function and arguments of the methods of laws."""
    for name, model in made.items():
        law = noise.listener(model).law(PING)
        methods = {
            "arrival": {"z": ROWS}, "between": {"low": 0.5 * ROWS, "high": ROWS}, "cdf": {"range_": 1.0},
            "cdf_step": {"step": STEPS}, "credence": {"tolerance": 0.1}, "edge": {"step": STEPS},
            "log_prob": {"reading": READ}, "quantile": {"p": 0.5}, "step": {"range_": 1.0},
        }  # fmt: skip
        for method, given in methods.items() if law.has_probabilities else ():
            yield f"{name} law {method}", getattr(law, method), given
        yield f"{name} law sample", law.sample, {"rng": np.random.default_rng(0)}


def calls_of_models(made, folder):
    """Yield name, function and arguments of the methods of models."""
    for name, model in made.items():
        yield f"{name} law", model.law, {"ping": PING, "past": None}
        if "sensors" in inspect.signature(model.law).parameters:
            yield f"{name} sensors", model.law, {"ping": PING, "past": READ, "sensors": np.arange(2)}
            yield f"{name} follow", model.follow, {"ping": PING, "reading": READ}
        if hasattr(model, "from_dict"):
            yield f"{name} from_dict", model.from_dict, {"data": model.to_dict()}
        if hasattr(model, "write_weights"):
            yield f"{name} write_weights", model.write_weights, {"folder": folder}
            loaded = {"folder": folder, "data": model.to_dict()}
            takes_kind = "load_kind" in inspect.signature(model.load).parameters
            yield f"{name} load", model.load, loaded | ({"load_kind": lambda *_: made["ideal"]} if takes_kind else {})


def calls_of_noise(made, folder):
    """Yield name, function and arguments of functions and classes of `noise`."""
    ideal, gaussian, plain, lstm = (made[name] for name in ("ideal", "gaussian", "physical", "srf08-lstm"))
    conditions, rng = Conditions.of(PING), np.random.default_rng(0)
    table = noise.CredenceTable.of(gaussian, noise.ConditionPrior(distances=9), 10)
    law = gaussian.law(PING)
    prior = {"near": 0.03, "far": 6.0, "distances": 9, "angles_deg": (0.0,), "reflectances": (0.5,)}
    network = {"inputs": lstm.inputs, "head": lstm.head, "layers": lstm.layers, "about": {}, "card": ""}
    yield "Composed", noise.ComposedModel, {"model": gaussian, "before": plain.effects, "after": plain.effects}
    yield "Prior", lambda **given: noise.ConditionPrior(**given).grid(), prior
    yield "Table", noise.CredenceTable, {"edges": EDGES, "values": np.ones(3), "share": np.ones(3)}
    yield "Table.of", noise.CredenceTable.of, {"model": gaussian, "prior": None, "bins": 9, "tolerance": 0.1}
    yield "Table.over", noise.CredenceTable.over, {"model": gaussian, "ping": PING, "edges": EDGES, "tolerance": 0.1}
    yield "Table.by_sampling", noise.CredenceTable.by_sampling, {"law": law, "edges": EDGES, "tolerance": 0.1}
    yield "Table.given", table.given, {"reading": READ}
    yield "Table.mixed", table.mixed, {"other": table, "weight": 0.5}
    yield "Faulty", noise.Faulty, {"model": ideal, "faults": [Short(rate=0.1)]}
    yield "Physical", noise.PhysicalModel, {"effects": plain.effects, "resolution": 0.01, "max_range": 3.0}
    yield "Physical.state", plain.state, {"conditions": conditions}
    yield "Physical.applied", plain.applied, {"state": plain.state(conditions)}
    yield "Physical.law_of", plain.law_of, {"conditions": conditions}
    yield "Mlp", noise.MlpModel, network | {"persistence": None}
    yield "Lstm", noise.LstmModel, network | {"cell": lstm.cell, "base": None}
    yield "follow", noise.follow, {"model": lstm, "ping": PING, "reading": READ}
    yield "listener", noise.listener, {"model": ideal}
    yield "load_model", noise.load_model, {"name": "ideal"}
    yield "save_model", noise.save_model, {"model": ideal, "folder": folder / "model"}
    yield "simulate", noise.simulate, {"model": lstm, "ping": PING, "rng": rng}
    yield "crps", crps, {"law": law, "reading": READ, "levels": 10}
    yield "pit", pit, {"law": law, "reading": READ, "rng": rng}
    yield "evaluate", evaluate, {"model": gaussian, "ping": PING, "reading": READ, "cluster": [0, 1]}
    yield "wilson", wilson, {"hits": [1], "trials": [2], "z": 1.96}


def calls_of_acquisition(folder):
    """Yield name, function and arguments of functions and classes of `acquisition`."""
    fields = dict.fromkeys(("distance", "angle", "incidence", "reflectance", "time"), ROWS)
    yield "Ping", Ping, {**fields, "run": STEPS, "covariates": {}}
    yield "Ping.of", Ping.of, {"distance": 1.0, "angle": 0.0, "reflectance": 1.0, "run": 0, "gain": 1.0}
    yield "Ping[]", PING.__getitem__, {"index": slice(None)}
    yield "Reading", Reading, {"range": ROWS, "status": np.ones(2, np.uint8), "echoes": np.zeros((2, 0))}
    yield "Reading.of", Reading.of, {"range_": 1.0, "status": 1, "echoes": None}
    yield "previous", previous, {"reading": READ, "run": STEPS}
    yield "as_recording", as_recording, {"given": REC, "name": "given"}
    yield "Recording", Recording, {"table": REC.table, "name": "x"}
    yield "Recording.from_text", Recording.from_text, {"text": REC.table.astype(str), "name": "x"}
    yield "Recording.has", REC.has, {"column": "x"}
    yield "Recording.of", Recording.of, {"ping": PING, "reading": READ, "name": "x", "gain": ROWS}
    yield "Recording.save", REC.save, {"path": folder / "recording.csv"}
    yield "Recording.select", lambda select: REC.select(select), {"select": [0]}
    yield "Rig.ping", Rig().ping, {"ping": PING, "rng": np.random.default_rng(0)}
    yield "Setup.draw", Setup.draw, {"serial": 1}
    yield "Unit.draw", Unit.draw, {"serial": 1}


def calls_of_bridges(folder):
    """Yield name, function and arguments of the bridges."""
    drive = folder / "drive.rec"
    drive.write_bytes(encode(READING, {"distance": 1.0}, sent=(1, 0), sampled=(1, 0)))
    (folder / "room.map").write_text(WALLS)
    times = {"sent": (1, 2), "received": (0, 0), "sampled": (1, 2)}
    scan = {"ranges": np.ones(8), "angle_min": 0.0, "angle_increment": 0.1, "range_max": 3.0, "count": 4}
    settings = {name: p.default for name, p in inspect.signature(ServerSettings).parameters.items()}
    yield "encode", encode, {"message": READING, "fields": {"distance": 1.0}, "sender_stamp": 0, **times}
    yield "decode", decode, {"datagram": b"x"}
    yield "time_of", time_of, {"seconds": 1.0}
    yield "read_rec", lambda path: list(read_rec(path)), {"path": drive}
    yield "recording_of", recording_of, {"path": drive, "period_s": 0.0, "constants": {"distance_mm": 1000.0}}
    yield "write_rec", write_rec, {"recording": REC, "path": folder / "out.rec", "start_s": 1e9}
    yield "load_map", load_map, {"path": folder / "room.map"}
    yield "scan_sectors", scan_sectors, {**scan, "range_min": 0.1}
    yield "range_values", range_values, {"reading": READ, "min_range": 0.03}
    yield "ideal_distances", ideal_distances, {"value": ROWS, "min_range": 0.03, "max_range": 3.0}
    yield "HeardRanges", HeardRanges, {"model": "ideal", "max_range": 6.0, "reflectance": 0.5, "seed": 0}
    yield "ping_message", protocol.ping_message, {"ping": PING}
    yield "ServerSettings", ServerSettings, settings
    yield "SonarServer", SonarServer, {"model": "ideal", "settings": None}
    yield "SonarClient", SonarClient, {"host": "127.0.0.1", "port": 1, "timeout_s": 0.1}


class Standing:
    """A controller that does nothing."""

    def reset(self):
        """Begin an episode."""

    def act(self, observation):
        """Return the action."""
        return np.zeros(2)


def finite_step(env):
    """Return the step of an environment, which fails where a reward is not finite."""

    def step(action):
        reward = env.step(action)[1]
        assert np.all(np.isfinite(reward)), reward

    return step


def calls_of_environments():
    """Yield name, function and arguments of environments, wrappers and controllers."""
    parking = {"id": "SonarParking-v0", "max_episode_steps": 3}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        envs = {
            "env": sonar_gym.SonarParkingEnv(), "goal": sonar_gym.SonarParkingGoalEnv(),
            "fleet": sonar_gym.SonarParkingVectorEnv(2),
            "wrapped": sonar_gym.SonarObservation(gymnasium.make(**parking)),
            "wrapped fleet": sonar_gym.SonarVectorObservation(sonar_gym.SonarParkingVectorEnv(2)),
        }  # fmt: skip
        observations = {name: env.reset(seed=0)[0] for name, env in envs.items()}
    for name, env in envs.items():
        yield f"{name} step", finite_step(env), {"action": np.zeros(env.action_space.shape)}
        yield f"{name} reset", env.reset, {"seed": 0, "options": None}
    goals = {key: observations["goal"][key] for key in ("achieved_goal", "desired_goal")}
    yield "goal reward", envs["goal"].compute_reward, {**goals, "info": {}}
    many, driver, agent = sonar_gym.SonarVecEnv(2), sonar_gym.ParkingDriver(), sonar_gym.load_agent()
    yield "SonarVecEnv", sonar_gym.SonarVecEnv, {"num_envs": 1, "sonar": "ideal"}
    yield "SonarVecEnv.seed", many.seed, {"seed": 0}
    yield "SonarVecEnv.set_options", many.set_options, {"options": {}}
    yield (
        "Curriculum",
        sonar_gym.Curriculum,
        {"success": 0.8, "step": 0.1, "episodes": 9, "begin": "easy", "end": "hard"},
    )
    yield "Curriculum state", sonar_gym.Curriculum().load_state_dict, {"state": sonar_gym.Curriculum().state_dict()}
    yield "ParkingDriver", sonar_gym.ParkingDriver, {"mounts": LAYOUTS["eight"], "car": None, "max_range": 3.0}
    yield "ParkingDriver perception", sonar_gym.ParkingDriver, {"perception": "survey"}
    yield "ParkingDriver.act", driver.act, {"observation": observations["env"]}
    yield "agent.act", agent.act, {"observation": observations["env"]}
    yield "load_agent", sonar_gym.load_agent, {"name": "parking"}
    episode = {"env": gymnasium.make(**parking), "driver": Standing(), "seed": 0, "every": 1}
    yield "run_episode", sonar_gym.run_episode, episode
    wrapper = {
        "env": gymnasium.make(**parking), "sonar": "ideal", "indices": None, "period_s": 0.0, "incidence": (0.0, 0.4),
        "sonar_layout": None,
    }  # fmt: skip
    yield "SonarObservation", sonar_gym.SonarObservation, wrapper
    yield "SonarVectorObservation", sonar_gym.SonarVectorObservation, {"env": sonar_gym.SonarParkingVectorEnv(2)}
    for cls in (sonar_gym.SonarParkingEnv, sonar_gym.SonarParkingVectorEnv):
        yield cls.__name__, cls, {name: p.default for name, p in inspect.signature(cls).parameters.items()}


def calls(folder: Path):
    """Return function and arguments of a valid call by name."""
    made = models()
    every = (
        *calls_of_laws(made), *calls_of_models(made, folder), *calls_of_noise(made, folder),
        *calls_of_acquisition(folder), *calls_of_bridges(folder), *calls_of_environments(),
    )  # fmt: skip
    return {name: (function, given) for name, function, given in every}
