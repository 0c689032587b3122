"""Does realistic sonar make a better driver? Train with several sonars, test all where the sonar is the rig.

Two worlds stand for the real one: the rig as the laboratory knows it, and the rig with its sensors moved back, which
the simulator does not know and the diagnosis has to find. All agents have the same budget, and drive the same streets.
What is done already is kept, so the experiment can be killed and gone on with.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console

from acquisition import Recording, SettingError
from acquisition.bench import Rig, Setup, Unit
from acquisition.io.files import write_bytes, write_text
from noise import SonarModel, load_model, save_model
from noise.beam import fit_beam
from noise.fitting.threads import keep_one_thread, one_thread
from noise.model import MAX_RANGE
from noise.rig import SIMULATED, RigModel
from sonar_gym.agent import load_policy
from training.agents import train
from training.agents.evaluate import Rate, crew_of, evaluate
from training.agents.real import MovedModel, RealModel
from training.agents.worlds import with_faults
from training.common.canvas import AFTER, INK, SOFT, Axes, panels
from training.common.paired import Paired
from training.common.progress import bar
from training.diagnosis import diagnose
from training.diagnosis.demo import record
from training.noise.train import fit_gaussian

LEARNED = "srf08-mlp"
FOUND = "learned+found"
FAULTS = "+faults"  # the same, and in half of the cars the same made worse
PLAIN = ("ideal", "gaussian", "beam", "learned", "corrected", FOUND)
ARMS = (*PLAIN, "ideal" + FAULTS, "learned" + FAULTS, FOUND + FAULTS)
WORLDS = {"rig": "the rig", "moved": "the rig, sensors moved back"}
GAIN = 31  # of the SRF08 as in the learned model's survey


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym transfer`."""

    out: Path = Path("runs/transfer")
    """Folder of recordings, diagnosis, agents and scores; what is in it already is not done again."""
    seeds: int = 3
    """Agents trained with each sonar."""
    episodes: int = 30
    """Streets that each agent drives in each world; the same for all."""
    lessons: int = 500
    """Rounds of imitation of each agent."""
    steps: int = 0
    """Steps of trial of each agent, after imitation."""
    num_envs: int = 128
    """Cars that drive at the same time in training."""
    moved_mm: float = 50.0
    """How far behind its place each sensor stands in the second world."""
    workers: int = 2
    """Processes."""
    seed: int = 0
    """Of recordings, agents and streets."""

    def __post_init__(self) -> None:
        """Refuse to compare nothing."""
        if min(self.seeds, self.episodes, self.workers) < 1:
            raise SettingError(
                f"seeds {self.seeds}, episodes {self.episodes} and workers {self.workers} must be 1 or more"
            )


# ---- what is trained with, and where it is tested --------------------------------------------------------------------


def prepare(args: Args) -> None:
    """Record the laboratory and the world that differs, fit the baselines, and diagnose."""
    simulated, recorded = args.out / "simulated.csv", args.out / "recorded.csv"
    if (args.out / "diagnosis" / "corrected").exists():
        return
    laboratory = Setup(gain=GAIN)
    nominal = record(laboratory, simulated, args.seed, 1)
    record(replace(laboratory, zero_m=1e-3 * args.moved_mm), recorded, args.seed, 2)
    for name, model in baselines(nominal).items():
        save_model(model, args.out / "models" / name)
    diagnosis = diagnose.examine(diagnose.Args(recorded, args.out / "diagnosis", simulated=simulated))
    write_text(args.out / "diagnosis.txt", "\n".join(diagnose.summary(diagnosis, args.out / "diagnosis")) + "\n")


def baselines(recording: Recording) -> dict[str, SonarModel]:
    """Return the usual stand-ins for a sonar, fitted to a recording."""
    seen, step = recording.reading.answered, recording.resolution
    ping, reading = recording.ping[seen], recording.reading[seen]
    reach = max(MAX_RANGE, float(reading.range.max()) + step)
    return {"gaussian": fit_gaussian(ping, reading, step, reach), "beam": fit_beam(ping, reading, step, reach)[0]}


def name_of(arm: str, out: Path) -> str:
    """Return the name or folder of the sonar that an arm trains with, faults aside."""
    arm = arm.removesuffix(FAULTS)
    places = {"ideal": "ideal", "learned": LEARNED, FOUND: FOUND, "corrected": str(out / "diagnosis" / "corrected")}
    return places.get(arm, str(out / "models" / arm))


def sonar_of(arm: str, out: Path) -> SonarModel:
    """Return the sonar that an arm trains with.

    "corrected" is the diagnosis's own model, an emulator of the survey with what was found in it; "learned+found" is
    the learned law with the zero that the diagnosis found. Faults are in none of them.
    """
    arm = arm.removesuffix(FAULTS)
    if arm != FOUND:
        return load_model(name_of(arm, out))
    effects = load_model(out / "diagnosis" / "corrected").to_dict()["effects"]  # type: ignore[attr-defined]
    return MovedModel(load_model(LEARNED), float(effects.get("zero_offset", {}).get("offset_m", 0.0)))


def rig_of(world: str, args: Args) -> RigModel:
    """Return the rig of a world."""
    zero = 1e-3 * args.moved_mm if world == "moved" else 0.0
    return RigModel(Rig(Unit.nominal(), replace(SIMULATED, zero_m=zero)))


# ---- jobs ------------------------------------------------------------------------------------------------------------


def place(args: Args, arm: str, seed: int) -> Path:
    """Return the folder of an agent's training."""
    return args.out / "agents" / f"{arm}-{seed}"


def train_agent(args: Args, arm: str, seed: int) -> str:
    """Train one agent, where that is not done."""
    sonar = sonar_of(arm, args.out)
    heard = (sonar, with_faults(sonar)) if arm.endswith(FAULTS) else (sonar,)
    train.train(
        train.Args(
            place(args, arm, seed),
            sonars=(name_of(arm, args.out),),
            faults=arm.endswith(FAULTS),
            lessons=args.lessons,
            steps=args.steps,
            num_envs=args.num_envs,
            hidden=(128, 64),
            seed=1000 * args.seed + seed,
        ),
        worlds=[{"sonar": one} for one in heard],
    )
    return f"{arm}-{seed}"


def test(args: Args, arm: str, seed: int, world: str) -> str:
    """Let one agent drive in one world, where that is not done."""
    path = args.out / "scores" / f"{world}-{arm}-{seed}.csv"
    if not path.exists():
        policy = load_policy(place(args, arm, seed) / train.AGENT)
        sonar = RealModel(rig_of(world, args), sonar_of(arm, args.out))
        seeds = range(args.episodes)
        with one_thread():
            one = evaluate(crew_of(policy), {"sonar": sonar, "threads": 1}, seeds, pooled=True)
        ends = {"success": one.success, "collision": one.collision, "steps": one.steps}
        about = {"world": world, "arm": arm, "seed": seed}
        write_text(path, pd.DataFrame({**about, "street": one.seeds, **ends}).to_csv(index=False))
    return path.stem


def run(args: Args) -> pd.DataFrame:
    """Do everything that is not done; returns an episode a row."""
    prepare(args)
    agents = list(product(range(args.seeds), ARMS))
    with ProcessPoolExecutor(args.workers, initializer=keep_one_thread) as pool:
        trainings = [pool.submit(train_agent, args, arm, seed) for seed, arm in agents]
        _await(trainings, "training")
        tests = [pool.submit(test, args, arm, seed, world) for (seed, arm), world in product(agents, WORLDS)]
        _await(tests, "driving in the rig")
    paths = [args.out / "scores" / f"{w}-{a}-{s}.csv" for (s, a), w in product(agents, WORLDS)]
    return pd.concat([pd.read_csv(path) for path in paths], ignore_index=True)


def _await(jobs: Sequence[Future[str]], what: str) -> None:
    with bar(what, len(jobs)) as tell:
        for k, job in enumerate(as_completed(jobs)):
            job.result()
            tell(k + 1, len(jobs))


# ---- what came of it -------------------------------------------------------------------------------------------------


def table(found: pd.DataFrame) -> str:
    """Return the results in Markdown; differences are against the agents of the ideal sonar, street by street."""
    heads = ("world", "trained with", "parked", "each seed", "touched something", "against ideal, points")
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for world, arm in product(WORLDS, ARMS):
        one = _of(found, world, arm)
        seeds = ", ".join(f"{100 * share:.0f}" for share in one.groupby("seed")["success"].mean())
        parked, touched = (Rate(int(one[name].sum()), len(one)) for name in ("success", "collision"))
        ideal = _of(found, world, "ideal")["success"].to_numpy(bool)
        against = "" if arm == "ideal" else str(Paired.of(ideal, one["success"].to_numpy(bool)))
        lines.append(f"| {WORLDS[world]} | {arm} | {parked} | {seeds} | {touched} | {against} |")
    return "\n".join(lines)


def _of(found: pd.DataFrame, world: str, arm: str) -> pd.DataFrame:
    return found[(found["world"] == world) & (found["arm"] == arm)].sort_values(["seed", "street"])


def figure(found: pd.DataFrame) -> bytes:
    """Return success and collisions of each arm in each world, with intervals and each seed's own share, as PNG."""
    draws = [lambda ax, w=world: _draw(ax, found, w) for world in WORLDS]
    return panels(draws, (12.0, 4.2), share_y=True)


def _draw(axes: Axes, found: pd.DataFrame, world: str) -> None:
    for name, colour, shift in (("success", AFTER, -0.1), ("collision", SOFT, 0.1)):
        for x, arm in enumerate(ARMS):
            one = _of(found, world, arm)
            rate = Rate(int(one[name].sum()), len(one))
            low, high = rate.interval
            ends = [[100 * (rate.share - low)], [100 * (high - rate.share)]]
            axes.errorbar(
                [x + shift], [100 * rate.share], ends, fmt="o", color=colour, capsize=3,
                label=("parked" if name == "success" else "touched something") if x == 0 else None,
            )  # fmt: skip
            each = 100 * one.groupby("seed")[name].mean().to_numpy()
            axes.plot(np.full(len(each), x + 2 * shift), each, ".", color=colour, alpha=0.5, markersize=4)
    axes.set_xticks(range(len(ARMS)), ARMS, rotation=25, ha="right", rotation_mode="anchor")
    axes.set_ylim(-3, 118)
    axes.set_title(WORLDS[world])
    axes.set_ylabel("of episodes, %", color=INK)
    axes.legend(loc="upper left", ncols=2)


def main(args: Args) -> None:
    """Run the experiment, print its table, write transfer.csv, transfer.md and transfer.png."""
    found = run(args)
    text = table(found)
    write_text(args.out / "transfer.csv", found.to_csv(index=False))
    write_text(args.out / "transfer.md", text + "\n")
    write_bytes(args.out / "transfer.png", figure(found))
    Console(soft_wrap=True, highlight=False).print(text)
