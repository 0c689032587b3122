"""The console command `sonar-gym`: one module per subcommand, each with a frozen `Args` dataclass and a `main`."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import tyro

from acquisition import MissingExtraError, SettingError
from acquisition.io.places import check_places
from acquisition.limits import check_settings, near, shown
from acquisition.name_check import check_noise
from training.common.door import door, parsing

# subcommand -> (module below `training` with `Args` and `main(args)`, summary). A module is imported only when its
# command runs, so that recording on a small machine needs none of the heavy packages.
COMMANDS = {
    "demo": ("diagnosis.demo", "record with a concealed effect, diagnose, correct, and park; three minutes"),
    "record": ("recordings.record", "record a survey with a sonar or with the simulated waveform rig"),
    "import": ("recordings.import_log", "convert the log of another program into a recording"),
    "plot": ("recordings.plot", "plot a recording: credence, detection, readings, readings over time"),
    "train-noise": ("noise.train", "train a noise model on a recording"),
    "train-agent": ("agents.train", "train a parking agent with the sonar models you choose"),
    "zoo": ("agents.zoo.command", "train a plain algorithm with tuned settings and test it on unseen streets"),
    "evaluate-agent": ("agents.evaluate", "measure how often agents park in the same streets"),
    "make-noise": ("noise.make", "train the shipped noise models again"),
    "noise-report": ("noise.report", "write the page that compares all noise models"),
    "ship-agent": ("agents.ship", "score an agent on unseen streets and write it with its card"),
    "sweep": ("agents.sweep", "train agents with many seeds and settings on Ray Tune"),
    "transfer": ("agents.transfer", "train agents with several sonar models and test all of them in the rig"),
    "compare-noise": ("noise.compare", "score noise models and baselines on recordings of other sensors"),
    "compare-optimizers": ("thesis.compare_optimizers", "train the thesis's networks and compare with its tables"),
    "compare-thesis": ("thesis.compare_thesis", "compare the rig with the networks published with the thesis"),
    "compare-drivers": ("agents.compare_drivers", "park with ideal and noisy sonars, with and without credence"),
    "diagnose": ("diagnosis.diagnose", "find where a simulation and a recording differ, and why; correct the model"),
    "bridge": ("bridges.bridge", "connect to OpenDLV, ROS and Webots: sonars, a car, an agent, files"),
    "serve": ("bridges.serve", "answer other programs' pings over TCP"),
    "export": ("bridges.export", "write the nearest sonar that Webots or Gazebo can hold"),
    "prove": ("proof.run", "run blind trials of the diagnosis: sealed, scored, published"),
    "verify-proof": ("proof.verify", "verify the ledger of such trials"),
    "generate-trials": ("diagnosis.generators.command", "write labelled pairs of a simulation and a recording"),
    "effects": ("diagnosis.effects", "list the effects that a diagnosis can name"),
    "judge": ("diagnosis.judging.command", "measure the diagnosis on labelled trials and on real recordings"),
    "fit-decision": ("diagnosis.judging.fit_command", "fit the probabilities of causes on labelled trials"),
}
FOOT = "`sonar-gym COMMAND --help` lists the options of each; --debug shows the traceback of a failure."
DEBUG = "--debug"  # of every command: shows the traceback of a failure


def main(argv: Sequence[str] | None = None) -> None:
    """Run one subcommand. A failure is one line on stderr; exit code 2 if the user can correct it, else 1."""
    given = list(sys.argv[1:] if argv is None else argv)
    argv = [word for word in given if word != DEBUG]
    with door(given, debug=DEBUG in given):
        if not argv or argv[0] in ("-h", "--help"):
            print(overview())
        elif argv[0] == "--version":
            print(f"sonar-gym {version('sonar-gym')}")
        elif argv[0] not in COMMANDS:
            hint = near(argv[0], COMMANDS) or f"; commands: {', '.join(COMMANDS)}"
            raise SettingError(f"{shown(argv[0])} is not a command{hint} See `sonar-gym --help`")
        else:
            _run(argv[0], argv[1:])


def overview() -> str:
    """Return the help text: one line per command."""
    lines = [f"  {name:<19} {summary}" for name, (_, summary) in COMMANDS.items()]
    head = "sonar-gym: realistic sonar for simulated robots\n\nusage: sonar-gym COMMAND [options]\n\ncommands:"
    return "\n".join(
        [
            head,
            *lines,
            "\n" + FOOT,
        ]
    )


def _run(name: str, argv: Sequence[str]) -> None:
    check_noise()
    module = _load(name)
    with parsing(name):
        args = tyro.cli(module.Args, prog=f"sonar-gym {name}", description=module.__doc__, args=argv)
    check_settings(args, lambda field: f"--{field.replace('_', '-')}")
    check_places(args)
    module.main(args)


def _load(name: str) -> Any:  # a module with Args and main
    try:
        return importlib.import_module(f"training.{COMMANDS[name][0]}")
    except ModuleNotFoundError as error:
        hint = "pip install 'sonar-gym[all]'"
        raise MissingExtraError(f"`sonar-gym {name}` needs the package {error.name!r}: {hint}") from None


if __name__ == "__main__":
    main()
