"""Train agents with several sonars, and test all of them in two worlds where the sonar is the waveform rig.

The first world is the rig as surveyed in the laboratory. In the second its sensors stand further back, which the
simulator does not model and the diagnosis has to find. All agents have the same budget and drive the same streets. To
continue an interrupted experiment, give the same command again.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
from rich.console import Console

from acquisition import Recording
from acquisition.bench import Rig, Setup, Unit
from acquisition.io.files import write_bytes, write_text
from acquisition.io.places import OutputFolder
from acquisition.limits import Count, Limit, Seed, Workers
from noise import SonarModel, load_model, save_model
from noise.beam import fit_beam
from noise.fitting.threads import keep_one_thread, one_thread
from noise.model import MAX_RANGE
from noise.rig import SIMULATED, RigModel
from sonar_gym.agent import load_policy
from training.agents import train
from training.agents.evaluate import Rate, evaluate, pool_of
from training.agents.sonars import MismatchedModel, ShiftedModel, with_faults
from training.common.canvas import AFTER, INK, SOFT, Axes, panels
from training.common.progress import bar
from training.common.statistics import PairedComparison
from training.common.tables import markdown_table
from training.diagnosis import diagnose
from training.diagnosis.demo import record
from training.noise.baselines import fit_gaussian

LEARNED = "srf08-mlp"
WITH_FOUND = "learned+found"
FAULTS = "+faults"  # suffix of arms in which half of the cars have the same sonar with faults
WITHOUT_FAULTS = ("ideal", "gaussian", "beam", "learned", "corrected", WITH_FOUND)
ARMS = (*WITHOUT_FAULTS, "ideal" + FAULTS, "learned" + FAULTS, WITH_FOUND + FAULTS)
WORLDS = {"rig": "the rig", "moved": "the rig, sensors moved back"}
GAIN = 31  # gain of the SRF08, as in the survey of the learned model
HEADER = ("world", "trained with", "parked", "each seed", "collided", "difference to ideal, points")


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym transfer`."""

    out: OutputFolder = Path("runs/transfer")
    """Folder for recordings, diagnosis, agents and scores; files that exist are not made again."""
    seeds: Annotated[int, Limit(1, 1000)] = 3
    """Number of agents trained with each sonar."""
    episodes: Count = 30
    """Number of streets that each agent drives in each world; the same streets for all."""
    lessons: Annotated[int, Limit(0, 1_000_000)] = 500
    """Rounds of imitation of each agent."""
    steps: Annotated[int, Limit(0, 10**12)] = 0
    """Environment steps of PPO of each agent, after imitation."""
    num_envs: Annotated[int, Limit(1, 65_536)] = 128
    """Number of cars in training."""
    moved_mm: Annotated[float, Limit(-1000.0, 1000.0, "mm")] = 50.0
    """Distance by which each sensor of the second world stands back, mm."""
    workers: Workers = 2
    """Number of processes."""
    seed: Seed = 0
    """Seed of recordings and agents."""


# ---- sonars of training and test -------------------------------------------------------------------------------------


def prepare(args: Args) -> None:
    """Record surveys in both worlds, fit the baselines, and diagnose the second world."""
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
    """Return common sonar models fitted to a recording."""
    answered, step = recording.reading.answered, recording.resolution
    ping, reading = recording.ping[answered], recording.reading[answered]
    reach = max(MAX_RANGE, float(reading.range.max()) + step)
    return {"gaussian": fit_gaussian(ping, reading, step, reach), "beam": fit_beam(ping, reading, step, reach)[0]}


def name_of(arm: str, out: Path) -> str:
    """Return the name or folder of the sonar model of an arm, without faults."""
    arm = arm.removesuffix(FAULTS)
    corrected = str(out / "diagnosis" / "corrected")
    names = {"ideal": "ideal", "learned": LEARNED, WITH_FOUND: WITH_FOUND, "corrected": corrected}
    return names.get(arm, str(out / "models" / arm))


def sonar_of(arm: str, out: Path) -> SonarModel:
    """Return the sonar model of an arm, without faults.

    "corrected" is the corrected model of the diagnosis: an emulator of the survey with the effects found.
    "learned+found" is the learned model with the zero offset found.
    """
    arm = arm.removesuffix(FAULTS)
    if arm != WITH_FOUND:
        return load_model(name_of(arm, out))
    effects = load_model(out / "diagnosis" / "corrected").to_dict()["effects"]  # type: ignore[attr-defined]
    return ShiftedModel(load_model(LEARNED), float(effects.get("zero_offset", {}).get("offset_m", 0.0)))


def rig_of(world: str, args: Args) -> RigModel:
    """Return the rig of a world."""
    zero = 1e-3 * args.moved_mm if world == "moved" else 0.0
    return RigModel(Rig(Unit.nominal(), replace(SIMULATED, zero_m=zero)))


# ---- jobs ------------------------------------------------------------------------------------------------------------


def agent_folder(args: Args, arm: str, seed: int) -> Path:
    """Return the folder of an agent's training."""
    return args.out / "agents" / f"{arm}-{seed}"


def score_path(args: Args, arm: str, seed: int, world: str) -> Path:
    """Return the file of an agent's episodes in one world."""
    return args.out / "scores" / f"{world}-{arm}-{seed}.csv"


def train_agent(args: Args, arm: str, seed: int) -> None:
    """Train one agent, or continue."""
    sonar = sonar_of(arm, args.out)
    sonars = (sonar, with_faults(sonar)) if arm.endswith(FAULTS) else (sonar,)
    train.train(
        train.Args(
            agent_folder(args, arm, seed),
            sonars=(name_of(arm, args.out),),
            faults=arm.endswith(FAULTS),
            lessons=args.lessons,
            steps=args.steps,
            num_envs=args.num_envs,
            hidden=(128, 64),
            seed=1000 * args.seed + seed,
        ),
        env_settings=[{"sonar": one} for one in sonars],
    )


def test_agent(args: Args, arm: str, seed: int, world: str) -> None:
    """Drive with one agent in one world, unless its scores exist."""
    path = score_path(args, arm, seed, world)
    if path.exists():
        return
    policy = load_policy(agent_folder(args, arm, seed) / train.AGENT)
    sonar = MismatchedModel(rig_of(world, args), sonar_of(arm, args.out))
    with one_thread():
        one = evaluate(pool_of(policy), {"sonar": sonar, "threads": 1}, range(args.episodes), pooled=True)
    ends = {"success": one.success, "collision": one.collision, "steps": one.steps}
    about = {"world": world, "arm": arm, "seed": seed}
    write_text(path, pd.DataFrame({**about, "street": one.seeds, **ends}).to_csv(index=False))


def run(args: Args) -> pd.DataFrame:
    """Run or continue the experiment; returns one episode per row."""
    prepare(args)
    agents = [(arm, seed) for seed, arm in product(range(args.seeds), ARMS)]
    tests = [(*agent, world) for agent, world in product(agents, WORLDS)]
    with ProcessPoolExecutor(args.workers, initializer=keep_one_thread) as pool:
        _await([pool.submit(train_agent, args, *agent) for agent in agents], "training")
        _await([pool.submit(test_agent, args, *one) for one in tests], "driving in the rig")
    return pd.concat([pd.read_csv(score_path(args, *one)) for one in tests], ignore_index=True)


def _await(jobs: Sequence[Future[None]], task: str) -> None:
    with bar(task, len(jobs)) as on_progress:
        for k, job in enumerate(as_completed(jobs)):
            job.result()
            on_progress(k + 1, len(jobs))


# ---- results ---------------------------------------------------------------------------------------------------------


def table(results: pd.DataFrame) -> str:
    """Return the results in Markdown; differences are paired by street with the agents of the ideal sonar."""
    return markdown_table(HEADER, (_row(results, world, arm) for world, arm in product(WORLDS, ARMS)))


def _row(results: pd.DataFrame, world: str, arm: str) -> tuple[object, ...]:
    one = _of(results, world, arm)
    seeds = ", ".join(f"{100 * share:.0f}" for share in one.groupby("seed")["success"].mean())
    parked, collided = (Rate(int(one[name].sum()), len(one)) for name in ("success", "collision"))
    ideal = _of(results, world, "ideal")["success"].to_numpy(bool)
    difference = "" if arm == "ideal" else PairedComparison.of(ideal, one["success"].to_numpy(bool))
    return WORLDS[world], arm, parked, seeds, collided, difference


def _of(results: pd.DataFrame, world: str, arm: str) -> pd.DataFrame:
    return results[(results["world"] == world) & (results["arm"] == arm)].sort_values(["seed", "street"])


def figure(results: pd.DataFrame) -> bytes:
    """Return success and collision rates by arm and world, with intervals and single agents, as PNG."""
    return panels([partial(_draw, results, world) for world in WORLDS], (12.0, 4.2), share_y=True)


def _draw(results: pd.DataFrame, world: str, axes: Axes) -> None:
    for name, label, colour, shift in (("success", "parked", AFTER, -0.1), ("collision", "collided", SOFT, 0.1)):
        for x, arm in enumerate(ARMS):
            one = _of(results, world, arm)
            rate = Rate(int(one[name].sum()), len(one))
            low, high = rate.interval
            errors = [[100 * (rate.share - low)], [100 * (high - rate.share)]]
            y, shown = 100 * rate.share, label if x == 0 else None
            axes.errorbar([x + shift], [y], errors, fmt="o", color=colour, capsize=3, label=shown)
            each = 100 * one.groupby("seed")[name].mean().to_numpy()
            axes.plot(np.full(len(each), x + 2 * shift), each, ".", color=colour, alpha=0.5, markersize=4)
    axes.set_xticks(range(len(ARMS)), ARMS, rotation=25, ha="right", rotation_mode="anchor")
    axes.set_ylim(-3, 118)
    axes.set_title(WORLDS[world])
    axes.set_ylabel("episodes, %", color=INK)
    axes.legend(loc="upper left", ncols=2)


def main(args: Args) -> None:
    """Run the experiment, print its table, and write transfer.csv, transfer.md and transfer.png."""
    results = run(args)
    text = table(results)
    write_text(args.out / "transfer.csv", results.to_csv(index=False))
    write_text(args.out / "transfer.md", text + "\n")
    write_bytes(args.out / "transfer.png", figure(results))
    Console(soft_wrap=True, highlight=False).print(text)
