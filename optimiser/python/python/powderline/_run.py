"""The search, and what it found."""

from __future__ import annotations

import json
import sys
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Callable

from . import _native
from ._native import Plan, Scene

Epoch = dict[str, Any]


class Run:
    """What a search found, in a folder that the programs `optimise report` and `execute` know too.

    Attributes:
        folder: where it is.
        plan: the motion, a `Plan`; None before there is one.
        epochs: a dictionary for each epoch, as in `metrics.jsonl`: `epoch`, `world` ("coarse" or "fine"), `theta`, `loss` (m), `mass_kg`,
            `miss` (relative), `lost_kg`, `work` (rollouts and processor time), `seconds`, `slopes` (of methods that descend),
            `shipped` (whether it became the plan) and more.
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
        return None if self.plan is None else self.plan.mass_kg / self.plan.wanted_kg - 1.0

    def __repr__(self) -> str:
        found = "no plan yet" if self.plan is None else repr(self.plan)
        return f"Run({str(self.folder)!r}: {len(self.epochs)} epochs, {found})"

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
    precision: str | None = None,
    threads: int | None = None,
    memory: str | int = "1GiB",
    out: str | PathLike[str] | None = None,
    resume: str | PathLike[str] | None = None,
    callback: Callable[[Epoch], object] | None = None,
    verbose: bool = True,
) -> Run:
    """Searches the skill that brings what the scene wants, and writes its plan: a `Run`.

    The same as the program `optimise`, to the last bit. Ctrl-C stops it; what was evaluated is saved, and `resume` goes on.

    Args:
        scene: the bench; `bench` if neither it nor `resume` is given.
        seed: of the packing and of the search; the scene's if None.
        method: "surrogate" (the default: a coarse copy of the scene first), "restarted", "mixed", "differences", "exact", "cma-es",
            "sac" or "random".
        epochs: epochs after the first, at most; 16 if None.
        patience: ends when the amount is met and so many epochs in a row have gained nothing; 2 if None, 0 goes on to the last.
        precision: "f32" or "f64"; "f32", or that of the run, if None.
        threads: as many as the machine has processors, if None; changes no bit.
        memory: the most that the process may take, such as "2GiB" or a number of bytes.
        out: folder to write into, new or without a run; `runs/<scene>-seed<seed>`, numbered if taken, if None.
        resume: folder of a run to go on with, with a larger `epochs` also when it is finished.
        callback: called with each epoch's dictionary when it is saved (see `Run.epochs`; which becomes the plan is not known yet);
            what it raises stops the search.
        verbose: whether to write to `sys.stderr` how the search goes.

    Raises:
        ValueError: what was asked for makes no sense as it stands.
        SimulationError: it failed.
        KeyboardInterrupt: it was stopped.
    """
    if scene is not None and resume is not None:
        raise ValueError("give a scene to begin with, or resume=.. to go on with a run, not both")
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
        precision=precision,
        threads=threads,
        memory=memory,
        out=out,
        resume=resume,
        on_epoch=lambda line: callback(json.loads(line)) if callback is not None else None,
        say=lambda text: sys.stderr.write(text) if verbose else None,
    )
    return Run(found["folder"])
