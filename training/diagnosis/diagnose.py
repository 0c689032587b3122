"""Say where a simulation and a recording differ and why, in a report for people and a verdict for machines."""

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
from noise.discrepancy.emulate import Simulator
from noise.discrepancy.search import Progress as Tell
from noise.discrepancy.workers import usable
from noise.fitting.threads import one_thread
from noise.store import load_model, save_model
from training.common.progress import bars
from training.diagnosis.report import headline, render


@dataclass(frozen=True)
class Args:
    """Settings of `sonar-gym diagnose`."""

    recorded: Annotated[Path, tyro.conf.Positional]
    """Recording of the real sonar (CSV, one row a ping)."""
    out: Path
    """Folder to write: verdict.json, report.html, and the corrected model in corrected/."""
    model: str = "ideal"
    """What the simulation uses: a model's name (ideal, gaussian, ...) or the folder of a saved one."""
    simulated: Path | None = None
    """What stands in the place of the model: a simulator's readings in the recording format, or module:function, which
    is called as function(pings, rng) and returns readings."""
    seed: int = 0
    """Same seed, same verdict."""
    workers: int = field(default_factory=usable)
    """Processes that share the work, some 400 MB each; the verdict is the same with any number."""


def main(args: Args) -> None:
    """Diagnose, write the folder, print the verdict."""
    print("\n".join(summary(examine(args), args.out)))


def examine(args: Args) -> Diagnosis:
    """Diagnose and write the folder."""
    recorded = Recording.load(args.recorded)
    simulator = None if args.simulated is None else simulator_of(args.simulated)
    simulated = None if args.simulated is None or simulator is not None else Recording.load(args.simulated)
    model = simulator or load_model(args.model)
    _check_out(args.out)
    with one_thread(), _told() as tell:
        diagnosis = diagnose(model, recorded, simulated=simulated, seed=args.seed, progress=tell, workers=args.workers)
        tell("drawing the report", 0.97)
        page = render(diagnosis, str(args.out / "corrected"), args.seed)
    write_text(args.out / "verdict.json", json.dumps(diagnosis.to_verdict(), indent=1, allow_nan=False) + "\n")
    write_text(args.out / "report.html", page)
    save_model(diagnosis.corrected, args.out / "corrected")
    return diagnosis


def simulator_of(spelled: Path) -> Simulator | None:
    """Return the function that `module:function` names, looked for in the working directory too; None of a file.

    Raises:
        SettingError: there is no such module or function.
    """
    module, _, function = str(spelled).partition(":")
    if spelled.exists() or not function.isidentifier():
        return None
    sys.path.insert(0, "")
    try:
        found = getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise SettingError(f"--simulated {spelled}: {error}; give FILE.csv or module:function") from None
    finally:
        sys.path.remove("")
    if not callable(found):
        raise SettingError(f"--simulated {spelled}: {function} is a {type(found).__name__}, expected a function")
    return cast(Simulator, found)


def _check_out(out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise SettingError(f"--out {out}: is a file, expected a folder to write into; give another name")
    out.mkdir(parents=True, exist_ok=True)


@contextmanager
def _told() -> Iterator[Tell]:
    """Show a progress bar on stderr, where it is a terminal."""
    with bars() as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda message, share: bar.update(task, completed=share, description=message)


def summary(diagnosis: Diagnosis, out: Path) -> list[str]:
    """Return the verdict in about ten lines."""
    verdict = diagnosis.verdict
    held, p = verdict.held_out, verdict.p_value
    lines = [f"verdict: {verdict.verdict} (p = {p:.2g})", headline(diagnosis)]
    for named in verdict.effects:
        alike = ", ".join(named.indistinguishable_from)
        doubt = f"; not told apart from {alike}" if alike else ""
        lines.append(f"  {named.effect}: {named.gain_nats:.0f} ± {named.gain_se:.0f} nats{doubt}")
    if verdict.unknown.present:
        lines.append(f"  left over: {verdict.unknown.description}")
    lines += [f"  next: {m.do}" + (f" ({m.pings} pings)" if m.pings > 1 else "") for m in verdict.next_measurement[:2]]
    lines.append(
        f"unseen cells ({held.n_pings} pings): error {held.before.crps_mm:.1f} -> {held.after.crps_mm:.1f} mm (CRPS), "
        f"gain {held.gain_per_ping_low:.3f} to {held.gain_per_ping_high:.3f} nats a ping"
    )
    if not verdict.baseline_check.describes_simulation:
        lines.append(f"caution: {verdict.baseline_check.note}")
    if diagnosis.unanswered:
        lines.append(f"caution: {diagnosis.unanswered} pings were not answered (wire?) and left out")
    return [*lines, f"report: {out / 'report.html'}   model: {out / 'corrected'}"]
