"""Diagnosis of the differences between a simulation and a recording, as an HTML report and a JSON verdict."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, cast

import tyro

from acquisition import Recording, SettingError
from acquisition.io.files import write_text
from noise.discrepancy import Diagnosis, diagnose
from noise.discrepancy.baseline.emulate import Simulator
from noise.discrepancy.common.workers import usable
from noise.discrepancy.name.search import Progress
from noise.fitting.threads import one_thread
from noise.store import load_model, save_model
from training.common.progress import bars
from training.diagnosis.report import headline, render


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym diagnose`."""

    recorded: Annotated[Path, tyro.conf.Positional]
    """Recording of the real sonar (CSV, one row per ping)."""
    out: Path
    """Output folder: verdict.json, report.html, and the corrected model in corrected/."""
    model: str = "ideal"
    """Model of the simulation: a name (ideal, gaussian, ...) or the folder of a saved model."""
    simulated: Path | None = None
    """Simulator in place of the model: its readings in the recording format, or module:function, which is called as
    function(pings, rng) and returns readings."""
    seed: int = 0
    """Seed; the same seed gives the same verdict."""
    workers: int = field(default_factory=usable)
    """Number of processes, about 400 MB each; it does not affect the verdict."""


def main(args: Args) -> None:
    """Diagnose, write the output folder, print the verdict."""
    print("\n".join(summary(examine(args), args.out)))


def examine(args: Args) -> Diagnosis:
    """Diagnose and write the output folder."""
    recorded = Recording.load(args.recorded)
    simulator = None if args.simulated is None else simulator_of(args.simulated)
    simulated = None if args.simulated is None or simulator is not None else Recording.load(args.simulated)
    model = simulator or load_model(args.model)
    _check_out(args.out)
    with one_thread(), _progress() as update:
        diagnosis = diagnose(
            model, recorded, simulated=simulated, seed=args.seed, progress=update, workers=args.workers
        )
        update("drawing the report", 0.97)
        page = render(diagnosis, str(args.out / "corrected"), args.seed)
    write_text(args.out / "verdict.json", json.dumps(diagnosis.to_verdict(), indent=1, allow_nan=False) + "\n")
    write_text(args.out / "report.html", page)
    save_model(diagnosis.corrected, args.out / "corrected")
    return diagnosis


def simulator_of(given: Path) -> Simulator | None:
    """Return the function `module:function`, also from the working directory; None if a file is given.

    Raises:
        SettingError: the module or function does not exist.
    """
    module, _, function = str(given).partition(":")
    if given.exists() or not function.isidentifier():
        return None
    sys.path.insert(0, "")
    try:
        found = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise SettingError(f"--simulated {given}: {error}; give FILE.csv or module:function") from None
    finally:
        sys.path.remove("")
    if not callable(found):
        raise SettingError(f"--simulated {given}: {function} is a {type(found).__name__}, expected a function")
    return cast(Simulator, found)


def _check_out(out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise SettingError(f"--out {out}: is a file, expected a folder; give another name")
    out.mkdir(parents=True, exist_ok=True)


@contextmanager
def _progress() -> Iterator[Progress]:
    """Show a progress bar on stderr if it is a terminal."""
    with bars() as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda message, share: bar.update(task, completed=share, description=message)


def summary(diagnosis: Diagnosis, out: Path) -> list[str]:
    """Return the verdict as about ten lines of text."""
    verdict = diagnosis.verdict
    test = verdict.held_out
    lines = [f"verdict: {verdict.verdict} (p = {verdict.p_value:.2g})", headline(diagnosis)]
    for named in verdict.effects:
        rivals = ", ".join(named.indistinguishable_from)
        doubt = f"; indistinguishable from {rivals}" if rivals else ""
        lines.append(f"  {named.effect}: {named.gain_nats:.0f} ± {named.gain_se:.0f} nats{doubt}")
    if verdict.unknown.present:
        lines.append(f"  unexplained: {verdict.unknown.description}")
    lines += [f"  next: {m.do}" + (f" ({m.pings} pings)" if m.pings > 1 else "") for m in verdict.next_measurement[:2]]
    lines.append(
        f"test set ({test.n_pings} pings): CRPS {test.before.crps_mm:.1f} -> {test.after.crps_mm:.1f} mm, "
        f"gain {test.gain_per_ping_low:.3f} to {test.gain_per_ping_high:.3f} nats per ping"
    )
    if not verdict.baseline_check.describes_simulation:
        lines.append(f"caution: {verdict.baseline_check.note}")
    if diagnosis.unanswered:
        lines.append(f"caution: {diagnosis.unanswered} pings without an answer were omitted; check the wires")
    return [*lines, f"report: {out / 'report.html'}   model: {out / 'corrected'}"]
