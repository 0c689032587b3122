"""Train agents that observe ranges only, with echo flags, with credence, or everything, and test them in the rig.

All agents have the same algorithm (imitation), budget and streets; half of the cars have sonars with faults. The test
is the track "hard" of the leaderboard: the waveform rig, worn wheels, one sonar displaced and one with a loose contact.
The agent is the unit of all intervals. To continue an interrupted experiment, give the same command again.
"""

from __future__ import annotations

from concurrent.futures import as_completed
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd

from acquisition.io.files import write_text
from acquisition.io.places import OutputFolder
from acquisition.limits import Limit, Seed, Workers
from noise.fitting.threads import keep_one_thread, one_thread
from sonar_gym.agent import load_policy
from training.agents import train
from training.agents.evaluate import pool_of
from training.agents.leaderboard.tracks import TRACKS
from training.common.progress import bar
from training.common.statistics import AGENT_COLUMNS, AgentScores, agent_rows
from training.common.tables import markdown_table
from training.common.workers import worker_processes

ARMS = {  # what an agent observes besides ranges: credence, echo
    "ranges": (False, False),
    "ranges, echo": (False, True),
    "ranges, credence": (True, False),
    "everything": (True, True),
}
REFERENCE = "ranges, echo"  # what any real sonar gives
HEADER = ("observed", *(name.format(reference=f'"{REFERENCE}"') for name in AGENT_COLUMNS))


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym compare-observations`."""

    out: OutputFolder = Path("runs/observations")
    """Folder for agents and scores; files that exist are not made again."""
    agents: Annotated[int, Limit(2, 1000)] = 10
    """Number of agents of each arm."""
    streets: Annotated[int, Limit(1, 64)] = 32
    """Number of streets of the test, the same for all agents."""
    lessons: Annotated[int, Limit(1, 1_000_000)] = 600
    """Rounds of imitation of each agent."""
    num_envs: Annotated[int, Limit(4, 65_536)] = 128
    """Number of cars in training."""
    workers: Workers = 2
    """Number of processes."""
    seed: Seed = 0
    """Seed of the agents."""


def folder_of(args: Args, arm: str, agent: int) -> Path:
    """Return the folder of an agent."""
    return args.out / f"{arm.replace(', ', '+')}-{agent}"


def make(args: Args, arm: str, agent: int) -> None:
    """Train one agent, or continue, and test it, unless its scores exist."""
    folder = folder_of(args, arm, agent)
    if (folder / "scores.csv").exists():
        return
    credence, echo = ARMS[arm]
    settings = train.Args(
        folder,
        sonars=("srf08-mlp",),
        odometry=("wheels",),
        difficulty=("normal", "hard"),
        lessons=args.lessons,
        num_envs=args.num_envs,
        hidden=(128, 64),
        credence=credence,
        echo=echo,
        seed=1000 * args.seed + agent,
    )
    train.train(settings)
    track = replace(TRACKS["hard"], streets=args.streets)
    with one_thread():
        one = track.drive(pool_of(load_policy(folder / train.AGENT)), lambda done, total: None)
    about = {"arm": arm, "agent": agent, "street": one.seeds, "success": one.success, "collision": one.collision}
    write_text(folder / "scores.csv", pd.DataFrame(about).to_csv(index=False))


def run(args: Args) -> pd.DataFrame:
    """Run or continue the experiment, agent by agent of all arms; returns one episode per row."""
    jobs = [(arm, agent) for agent, arm in product(range(args.agents), ARMS)]
    workers = worker_processes(min(args.workers, len(jobs)), keep_one_thread, start=None)
    with workers as pool, bar("agents", len(jobs)) as update:
        for k, done in enumerate(as_completed([pool.submit(make, args, *job) for job in jobs])):
            done.result()
            update(k + 1, len(jobs))
    return pd.concat([pd.read_csv(folder_of(args, *job) / "scores.csv") for job in jobs], ignore_index=True)


def table(results: pd.DataFrame) -> str:
    """Return the results in Markdown; intervals at 95 % over agents."""
    rates = results.groupby(["arm", "agent"])["success"].mean()
    scores = {arm: AgentScores(rates[arm].to_numpy()) for arm in ARMS}
    return markdown_table(HEADER, agent_rows(scores, REFERENCE, np.random.default_rng(0)))


def main(args: Args) -> None:
    """Run the experiment, print its table, and write table.md."""
    text = table(run(args))
    write_text(args.out / "table.md", text + "\n")
    print(text)
