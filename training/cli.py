"""The console command `sonar-gym`: one subcommand a module, each a frozen `Args` dataclass with a `main`."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import tyro

from acquisition import SonarError

# subcommand -> module under `training` that holds `Args` and `main(args) -> None`
COMMANDS = {
    "demo": "training.demo",
    "record": "training.record",
    "import": "training.foreign",
    "train-noise": "training.noise_model",
    "diagnose": "training.diagnose",
}
USAGE = 2


def _commands(names: Sequence[str]) -> tuple[dict[str, Any], dict[str, Callable[[Any], None]]]:
    modules = {name: importlib.import_module(COMMANDS[name]) for name in names}
    return {name: module.Args for name, module in modules.items()}, {n: m.main for n, m in modules.items()}


def main(argv: Sequence[str] | None = None) -> None:
    """Run one subcommand; what a user can mend is told in one line on stderr, with exit code 2."""
    argv = list(sys.argv[1:] if argv is None else argv)
    # importing only the module that runs keeps `sonar-gym record` free of torch
    names = [argv[0]] if argv and argv[0] in COMMANDS else list(COMMANDS)
    types, mains = _commands(names)
    parser = tyro.extras.SubcommandApp()
    for name, args in types.items():
        parser.command(name=name)(_runner(args, mains[name]))
    try:
        parser.cli(prog="sonar-gym", args=argv, description=__doc__)
    except SonarError as error:
        print(f"sonar-gym: {' '.join(str(error).split())}", file=sys.stderr)
        raise SystemExit(USAGE) from None
    except KeyboardInterrupt:
        print("sonar-gym: interrupted; what was written before is whole", file=sys.stderr)
        raise SystemExit(130) from None


def _runner(args: type, run: Callable[[Any], None]) -> Callable[[Any], None]:
    def command(settings: Any) -> None:
        run(settings)

    command.__annotations__ = {"settings": Annotated[args, tyro.conf.arg(name="")], "return": None}
    command.__doc__ = args.__doc__
    return command


if __name__ == "__main__":
    main()
