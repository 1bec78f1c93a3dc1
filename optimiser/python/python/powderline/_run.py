"""The search, what it found, and pages of that."""

from __future__ import annotations

import html
import json
import sys
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Callable

from . import _native
from ._native import Plan, Scene

Epoch = dict[str, Any]


def _say(verbose: bool) -> Callable[[str], object]:
    return lambda text: sys.stderr.write(text) if verbose else None


class Run:
    """What a search found, in a folder that `report` and the program `execute` know too. In a notebook it shows its curves and its plan.

    Attributes:
        folder: where it is.
        plan: the motion, a `Plan`; None before there is one.
        epochs: a dictionary for each epoch, as in `metrics.jsonl`: `epoch`, `world` ("coarse" or "fine"), `theta`, `loss` (m), `mass_kg`,
            `miss` (relative), `lost_kg`, `work` (rollouts and processor time), `seconds`, `slopes` (of methods that descend),
            `shipped` (whether it became the plan, or was corrected to it) and more.
    """

    def __init__(self, folder: str | PathLike[str]) -> None:
        """Reads a run's folder."""
        self.folder = Path(folder)
        metrics = self.folder / "metrics.jsonl"
        if not self.folder.is_dir():
            raise ValueError(f"{self.folder}: there is no such folder; give that of a run")
        if not metrics.is_file():
            begun = (self.folder / "state").is_file()
            what = "no epoch of the run is finished yet" if begun else "there is no run in it"
            raise ValueError(f"{self.folder}: {what}")
        self.epochs: list[Epoch] = [json.loads(line) for line in metrics.read_text(encoding="utf-8").splitlines()]
        plan = self.folder / "skill.plan"
        self.plan: Plan | None = Plan.load(plan) if plan.exists() else None

    @property
    def scene(self) -> Scene:
        """The scene that was searched."""
        return Scene.load(fspath(self.folder / "scene.toml"))

    @property
    def miss(self) -> float | None:
        """How far what the plan brings is off the wanted mass, relative; None before there is a plan."""
        return None if self.plan is None else self.plan.miss

    @property
    def met(self) -> bool | None:
        """Whether that is within the scene's tolerance; None before there is a plan, and where as much as can be had is wanted."""
        return None if self.plan is None else self.plan.met

    @property
    def summary(self) -> str:
        """What was found, as the program says it at the end: whether the amount is met, where the rest of the powder is, which epoch
        became the plan and why, and, where it misses or much is lost, what could help."""
        return _native.summary(self.folder) or "No epoch is finished yet."

    def __fspath__(self) -> str:
        return fspath(self.folder)

    def __repr__(self) -> str:
        found = "no plan yet" if self.plan is None else repr(self.plan)
        return f"Run({str(self.folder)!r}: {found}, {len(self.epochs)} epochs)"

    def _repr_html_(self) -> str:
        """What a notebook shows: the curves, and the plan."""
        curves = self.folder / "curves.svg"
        picture = curves.read_text(encoding="utf-8") if curves.exists() else ""
        plan = "" if self.plan is None else self.plan._repr_html_()
        return f"<div>{picture}</div>{plan}"


def optimise(
    scene: Scene | None = None,
    *,
    seed: int | None = None,
    method: str | None = None,
    epochs: int | None = None,
    patience: int | None = None,
    refine: bool = True,
    precision: str | None = None,
    threads: int | None = None,
    memory: str | int = "1GiB",
    out: str | PathLike[str] | None = None,
    resume: str | PathLike[str] | None = None,
    callback: Callable[[Epoch], object] | None = None,
    verbose: bool = True,
) -> Run:
    """Searches the skill that brings what the scene wants, and writes its plan: a `Run`. That may miss the amount, which `Run.met` says,
    and `Run.summary` what could help.

    The same as the program `optimise`, to the last bit. Ctrl-C stops it; what was evaluated is saved, and `resume` goes on.

    Args:
        scene: the bench; `bench` if neither it nor `resume` is given.
        seed: of the packing and of the search; the scene's if None.
        method: "surrogate", the default: Gaussian processes of a coarse copy of the scene, where the first 8 epochs or so are spent, and
            of the scene itself; "restarted", "mixed", "differences", "exact": descent along the gradient of `Simulator.gradient`
            (restarted, exact adjoint and differences, differences, exact adjoint); "cma-es": covariance matrix adaptation; "sac": soft
            actor-critic; "random": drawn uniformly; "path": a skill as "surrogate" finds it, then splines in time that are added to its
            motion, down the restarted adjoint; "path-cma-es": the same by losses alone.
        epochs: epochs after the first, at most; 16 if None, 32 for a path. With fewer than some 10, "surrogate" hardly looks at the scene itself.
        patience: ends when the amount is met and so many epochs in a row have gained nothing; 2 if None, 0 goes on to the last.
        refine: whether the plan is simulated on cells of half the size at the end too, and corrected until the wanted amount arrives
            there; a rollout there takes 16 times as long.
        precision: "f32" or "f64"; "f32", or that of the run, if None.
        threads: as many as the machine has processors, if None; changes no bit.
        memory: the most that the process may take, such as "2GiB" or a number of bytes.
        out: folder to write into, new or without a run; `runs/<scene>-seed<seed>`, numbered if taken, if None.
        resume: folder of a run to go on with, with a larger `epochs` also when it is finished.
        callback: called with each epoch's dictionary when it is saved (see `Run.epochs`; which becomes the plan is not known yet);
            what it raises stops the search.
        verbose: whether to write to `sys.stderr` how the search goes, and what it found.

    Raises:
        ValueError: what was asked for makes no sense as it stands.
        SimulationError: it failed.
        KeyboardInterrupt: it was stopped.
    """
    if scene is not None and resume is not None:
        raise ValueError("give a scene to begin with, or resume=.. to go on with a run, not both")
    if out is not None and resume is not None:
        raise ValueError("a run that goes on writes into its own folder: give out=.. for a new one, or resume=.., not both")
    if scene is None and resume is None:
        scene = Scene.load()
    if callback is not None and not callable(callback):
        raise TypeError(f"callback is {callback!r}, but it must be a function, or None")
    if out is not None and Path(out).is_file():
        raise ValueError(f"out is {fspath(out)!r}, which is a file; give a folder, new or without a run")
    found = _native.optimise(
        scene,
        seed=seed,
        method=method,
        epochs=epochs,
        patience=patience,
        refine=refine,
        precision=precision,
        threads=threads,
        memory=memory,
        out=out,
        resume=resume,
        on_epoch=lambda line: callback(json.loads(line)) if callback is not None else None,
        say=_say(verbose),
    )
    run = Run(found["folder"])
    if verbose:
        sys.stderr.write(f"\n{run.summary}")
    return run


class Report:
    """A page of a run, of a comparison or of a plan: curves, tables, and the motion as a replay in 3-D. It is one file, `path`, that
    opens from disk; in a notebook it shows itself.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        """A page that is there already, whoever made it; `report` makes one."""
        self.path = Path(path)
        if not self.path.is_file():
            raise FileNotFoundError(f"{self.path}: there is no such page; `powderline.report` makes one")

    def __fspath__(self) -> str:
        return fspath(self.path)

    def __repr__(self) -> str:
        return f"Report({str(self.path)!r})"

    def _repr_html_(self) -> str:
        """What a notebook shows: the page in a frame of its own, whose styles and scripts touch nothing else."""
        page = html.escape(self.path.read_text(encoding="utf-8"))
        return f'<iframe srcdoc="{page}" style="width: 100%; height: 45em; border: 1px solid #ccc"></iframe>'


def report(
    of: Run | str | PathLike[str],
    *,
    executed: str | PathLike[str] | None = None,
    out: str | PathLike[str] | None = None,
    replay: bool = True,
    threads: int | None = None,
    memory: str | int = "1GiB",
    verbose: bool = True,
) -> Report:
    """Makes a page: a `Report`. The same as the program `optimise report`.

    Args:
        of: a `Run` or its folder, the folder of a comparison, or a plan's file.
        executed: file of the motion that the arm made of the plan, as `execute --record` writes it; shown over the planned one.
        out: the page; `report.html` in the folder, or beside the plan, if None.
        replay: whether the motion is simulated once more, and shown in 3-D; without it curves and tables come at once.
        threads: as many as the machine has processors, if None.
        memory: the most that the process may take, such as "2GiB" or a number of bytes.
        verbose: whether to write to `sys.stderr` what it warns of.

    Raises:
        ValueError: `of` or `executed` is not what it should be.
        SimulationError: it failed.
        KeyboardInterrupt: it was stopped.
    """
    made = _native.report(
        of, executed=executed, out=out, replay=replay, threads=threads, memory=memory, say=_say(verbose)
    )
    return Report(made["page"])
