"""Train agents with several sonars, and test all of them in two worlds where the sonar is the waveform rig.

The first world is the rig as surveyed in the laboratory. In the second its sensors stand further back, which the
simulator does not model and the diagnosis has to find. All agents of a learner have the same budget and drive the same
streets; the agent is the unit of all intervals. Arms take turns, so an experiment that is interrupted is balanced; to
continue it, give the same command again.
"""

from __future__ import annotations

import json
from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
import pandas as pd
from annotated_types import MinLen
from rich.console import Console

import sonar_gym
from acquisition import Recording
from acquisition.bench import Rig, Setup, Unit
from acquisition.io.files import write_bytes, write_text
from acquisition.io.places import OutputFolder
from acquisition.limits import Count, Limit, Seed, Workers
from noise import SonarModel, load_model, save_model
from noise.beam import fit_beam
from noise.discrepancy.thresholds import BELIEVED
from noise.fitting.threads import keep_one_thread, one_thread
from noise.model import MAX_RANGE
from noise.rig import SIMULATED, RigModel
from training.agents import train
from training.agents.drivers import pool_by_name
from training.agents.evaluate import evaluate
from training.agents.sonars import MismatchedModel, ShiftedModel
from training.agents.zoo import command as zoo
from training.agents.zoo.settings import tuned
from training.common.canvas import AFTER, INK, Axes, panels
from training.common.commit import commit
from training.common.progress import bar
from training.common.records import write_record
from training.common.statistics import AGENT_COLUMNS, AgentScores, agent_rows
from training.common.tables import markdown_table
from training.common.workers import worker_processes
from training.diagnosis import diagnose
from training.diagnosis.demo import record
from training.noise import corpus
from training.noise.baselines import fit_gaussian

LEARNED = "srf08-mlp"
WITH_FOUND = "learned+found"
Arm = Literal["ideal", "gaussian", "beam", "learned", "learned+found"]
Learner = Literal["ppo", "imitation"]
ARMS: tuple[Arm, ...] = get_args(Arm)
REFERENCE = "ideal"
WORLDS = {"rig": "the rig", "moved": "the rig, sensors moved back"}
SENSORS, PINGS_PER_VISIT = 20, 2  # of the learned model's survey, to which the baselines are fitted
GAIN = 31  # gain of the SRF08, as in the survey of the learned model
Shares = dict[str, dict[str, list[float]]]
HEADER = ("trained with", *(name.format(reference=REFERENCE) for name in AGENT_COLUMNS))


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym transfer`."""

    out: OutputFolder = Path("runs/transfer")
    """Folder for recordings, diagnosis, agents and scores; files that exist are not made again."""
    arms: Annotated[tuple[Arm, ...], MinLen(1)] = ARMS
    """Sonars of training; "ideal" is always among them."""
    learners: Annotated[tuple[Learner, ...], MinLen(1)] = get_args(Learner)
    """Plain PPO with the settings of the zoo, imitation with a memory, or both."""
    seeds: Annotated[int, Limit(2, 1000)] = 10
    """Number of agents trained by each learner with each sonar."""
    episodes: Count = 30
    """Number of streets that each agent drives in each world; the same streets for all."""
    lessons: Annotated[int, Limit(1, 1_000_000)] = 500
    """Rounds of imitation of each agent."""
    steps: Annotated[int, Limit(1, 10**12)] | None = None
    """Environment steps of PPO of each agent; by default the tuned number."""
    num_envs: Annotated[int, Limit(1, 65_536)] = 128
    """Number of cars in imitation."""
    moved_mm: Annotated[float, Limit(-1000.0, 1000.0, "mm")] = 50.0
    """Distance by which each sensor of the second world stands back, mm."""
    workers: Workers = 2
    """Number of processes."""
    seed: Seed = 0
    """Seed of recordings and agents."""

    @property
    def all_arms(self) -> tuple[str, ...]:
        """The arms with their reference, which comes first."""
        return tuple(arm for arm in ARMS if arm in (REFERENCE, *self.arms))


@dataclass(frozen=True)
class Job:
    """An agent of the experiment: its learner, arm and number."""

    learner: str
    arm: str
    number: int

    def __str__(self) -> str:
        return f"{self.learner}-{self.arm}-{self.number}"


def jobs_of(args: Args) -> list[Job]:
    """Return all agents, in the order in which they are made: the first of every arm, the second, ..."""
    order = product(range(args.seeds), args.learners, args.all_arms)
    return [Job(learner, arm, number) for number, learner, arm in order]


# ---- sonars of training and test -------------------------------------------------------------------------------------


def prepare(args: Args) -> None:
    """Fit the baselines to the learned model's survey, record surveys in both worlds, and diagnose the second."""
    for name in set(args.all_arms) & {"gaussian", "beam"}:
        if not (args.out / "models" / name).exists():
            save_model(baseline(name, learned_survey()), args.out / "models" / name)
    if WITH_FOUND not in args.all_arms or (args.out / "diagnosis" / "corrected").exists():
        return
    simulated, recorded = args.out / "simulated.csv", args.out / "recorded.csv"
    laboratory = Setup(gain=GAIN)
    record(laboratory, simulated, args.seed, 1)
    record(replace(laboratory, zero_m=1e-3 * args.moved_mm), recorded, args.seed, 2)
    diagnosis = diagnose.examine(diagnose.Args(recorded, args.out / "diagnosis", simulated=simulated))
    write_text(args.out / "diagnosis.txt", "\n".join(diagnose.summary(diagnosis, args.out / "diagnosis")) + "\n")


@lru_cache(maxsize=1)
def learned_survey() -> Recording:
    """Return the pings from which the learned model learns, of its first sensors."""
    sessions = corpus.RECORDINGS["train"]
    assert isinstance(sessions, corpus.Sessions)
    with bar("recording the survey", SENSORS) as on_progress:
        recording = corpus.record(replace(sessions, units=sessions.units[:SENSORS]), 1, on_progress)
    return recording.select(corpus.first_pings(recording, PINGS_PER_VISIT))


def baseline(name: str, recording: Recording) -> SonarModel:
    """Return a common sonar model, "gaussian" or "beam", fitted to a recording."""
    answered, step = recording.reading.answered, recording.resolution
    ping, reading = recording.ping[answered], recording.reading[answered]
    reach = max(MAX_RANGE, float(reading.range.max()) + step)
    return fit_gaussian(ping, reading, step, reach) if name == "gaussian" else fit_beam(ping, reading, step, reach)[0]


@lru_cache(maxsize=len(ARMS))
def sonar_of(arm: str, out: Path) -> SonarModel:
    """Return the sonar model of an arm; "learned+found" is the learned model with the zero offset found."""
    if arm in ("gaussian", "beam"):
        return load_model(out / "models" / arm)
    if arm == WITH_FOUND:
        return ShiftedModel(load_model(LEARNED), offset_found(out / "diagnosis"))
    return load_model(LEARNED if arm == "learned" else arm)


def offset_found(folder: Path) -> float:
    """Return the zero offset, m, that a diagnosis believes; 0 where it believes none."""
    causes = json.loads((folder / "verdict.json").read_text(encoding="utf-8"))["causes"]
    found = (c for c in causes if c["effect"] == "zero_offset" and c["probability"] >= BELIEVED)
    return next((1e-3 * float(c["parameters"]["offset_m"]["value"]) for c in found), 0.0)


def rig_of(world: str, args: Args) -> RigModel:
    """Return the rig of a world."""
    zero = 1e-3 * args.moved_mm if world == "moved" else 0.0
    return RigModel(Rig(Unit.nominal(), replace(SIMULATED, zero_m=zero)))


# ---- agents ----------------------------------------------------------------------------------------------------------


def make(args: Args, job: Job) -> None:
    """Train one agent, or continue, and drive it in both worlds, unless its scores exist."""
    path = score_path(args, job)
    if path.exists():
        return
    folder = args.out / "agents" / str(job)
    train_agent = {"ppo": _reinforced, "imitation": _imitated}[job.learner]
    driver, sonar = train_agent(args, job, folder), sonar_of(job.arm, args.out)
    parts = []
    for world in WORLDS:
        choice = {"sonar": MismatchedModel(rig_of(world, args), sonar), "threads": 1}
        with one_thread():
            one = evaluate(pool_by_name(str(driver), "ppo"), choice, range(args.episodes), pooled=True)
        ends = {"street": one.seeds, "success": one.success, "collision": one.collision, "steps": one.steps}
        about = {"learner": job.learner, "world": world, "arm": job.arm, "agent": job.number}
        parts.append(pd.DataFrame({**about, **ends}))
    write_text(path, pd.concat(parts).to_csv(index=False))


def score_path(args: Args, job: Job) -> Path:
    """Return the file of an agent's episodes."""
    return args.out / "scores" / f"{job}.csv"


def _imitated(args: Args, job: Job, folder: Path) -> Path:
    """Train one agent by imitation, or continue, and return its folder."""
    seed = 1000 * args.seed + job.number
    settings = train.Args(folder, (job.arm,), False, lessons=args.lessons, num_envs=args.num_envs, seed=seed)
    sonar = sonar_of(job.arm, args.out)
    train.train(replace(settings, hidden=(128, 64)), env_settings=[{"sonar": sonar}])
    return folder / train.AGENT


def _reinforced(args: Args, job: Job, folder: Path) -> Path:
    """Train one agent with plain PPO, or continue, and return its file."""
    path = folder / zoo.MODEL
    if not path.exists():
        choice = zoo.Args("ppo", folder, sonar=job.arm, steps=args.steps, seed=1000 * args.seed + job.number)
        with one_thread():
            sonar = sonar_of(job.arm, args.out)
            training = zoo.Training(choice, tuned("ppo", sonar_gym.ENV_ID), sonar=sonar)
            training.resume()
            zoo.save_model(training.run(), path)
        training.path.unlink(missing_ok=True)
    return path


def run(args: Args) -> pd.DataFrame:
    """Run or continue the experiment; returns one episode per row."""
    prepare(args)
    jobs = jobs_of(args)
    workers = worker_processes(min(args.workers, len(jobs)), keep_one_thread, start=None)
    with workers as pool, bar("agents", len(jobs)) as update:
        for k, done in enumerate(as_completed([pool.submit(make, args, job) for job in jobs])):
            done.result()
            update(k + 1, len(jobs))
    return pd.concat([pd.read_csv(score_path(args, job)) for job in jobs], ignore_index=True)


# ---- results ---------------------------------------------------------------------------------------------------------


def scores_of(results: pd.DataFrame, learner: str, world: str) -> dict[str, AgentScores]:
    """Return the share of streets in which each agent parked, by arm."""
    chosen = results[(results["learner"] == learner) & (results["world"] == world)]
    rates = chosen.groupby(["arm", "agent"])["success"].mean()
    return {arm: AgentScores(rates[arm].to_numpy()) for arm in ARMS if arm in rates}


def table(results: pd.DataFrame) -> str:
    """Return the results in Markdown, a table for each learner and world; intervals at 95 % over agents."""
    return "\n\n".join(
        f"{learner}, {title}:\n\n"
        + markdown_table(HEADER, agent_rows(scores_of(results, learner, world), REFERENCE, np.random.default_rng(0)))
        for learner, (world, title) in product(results["learner"].unique(), WORLDS.items())
    )


def shares_of(results: pd.DataFrame) -> Shares:
    """Return the share of streets in which each agent parked, by title of the panel and arm."""
    return {
        f"{learner}, {title}": {arm: one.scores.tolist() for arm, one in scores_of(results, learner, world).items()}
        for learner, (world, title) in product(results["learner"].unique(), WORLDS.items())
    }


def figure(shares: Shares) -> bytes:
    """Return success rates by arm, learner and world: agents, interquartile means and their intervals, as PNG."""
    parts = [
        partial(_draw, {arm: AgentScores(np.array(one)) for arm, one in arms.items()}, title)
        for title, arms in shares.items()
    ]
    return panels(parts, (8.0, 3.8 * -(-len(parts) // 2)), columns=2, share_y=True)


def _draw(scores: dict[str, AgentScores], title: str, axes: Axes) -> None:
    for x, one in enumerate(scores.values()):
        low, high = one.interval(np.random.default_rng(0))
        errors = 100 * np.array([[max(one.centre - low, 0.0)], [max(high - one.centre, 0.0)]])
        axes.errorbar([x], [100 * one.centre], errors, fmt="o", color=AFTER, capsize=3)
        axes.plot(np.full(len(one.scores), x + 0.2), 100 * one.scores, ".", color=AFTER, alpha=0.5, markersize=4)
    axes.set_xticks(range(len(scores)), list(scores), rotation=25, ha="right", rotation_mode="anchor")
    axes.set_ylim(-3, 103)
    axes.set_title(title)
    axes.set_ylabel("parked (%)", color=INK)


def main(args: Args) -> None:
    """Run the experiment, print its tables, and write transfer.csv, transfer.md and transfer.png with its record."""
    made_by, results, picture = commit(), run(args), args.out / "transfer.png"
    text = table(results)
    write_text(args.out / "transfer.csv", results.to_csv(index=False))
    write_text(args.out / "transfer.md", text + "\n")
    write_bytes(picture, figure(write_record(picture, made_by, "sonar-gym transfer", shares_of(results))))
    Console(soft_wrap=True, highlight=False).print(text)
