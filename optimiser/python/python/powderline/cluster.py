"""Long commands of `optimise` on a Ray cluster: the searches of a comparison, and the tables of how true the powders of many scenes are.

    from powderline import cluster

    found = cluster.compare("bench", "runs/thirty", seeds=range(30), address="10.0.0.1:6379")
    found["rows"]                                       # as `optimise compare --json` has them, one for each method
    tables = cluster.validate(["bench", "flour.toml"], full=True, address="10.0.0.1:6379")
    tables["flour.toml"]["lines"]                       # as `optimise validate --json` has them

The same from a shell, behind the command the options of `optimise`:

    python -m powderline.cluster --address 10.0.0.1:6379 compare bench --seeds 1,2,3,4,5,6 --out runs/six
    python -m powderline.cluster --address 10.0.0.1:6379 compare --resume runs/six
    python -m powderline.cluster --address 10.0.0.1:6379 validate bench flour.toml --full --write tables

It needs Ray (`pip install "powderline[campaign]"`), and each node this version of powderline. What comes of it is the same as on one
machine, but for processor times; `optimise compare --resume` goes on with what was begun here, and the other way round. Many ordinary
runs are a campaign: see `powderline.campaign`.
"""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from . import _native
from ._driver import PROGRAM, STOPPED, Board, ClusterError, Driver, Files, connected, count, files_of, need_ray, of_shell
from ._native import Scene, SimulationError

__all__ = ["ClusterError", "compare", "validate"]

#: After so long a search stops where it has just saved its state, and goes on in another task, seconds: what a lost node costs at most,
#: with an epoch more.
SLICE_S = 120.0
#: What a search's folder is called until it is whole, and while another one takes its place.
FRESH, FORMER = ".new", ".old"

Row = dict[str, Any]


def compare(
    scene: str | PathLike[str] | None = None,
    out: str | PathLike[str] | None = None,
    *,
    methods: Sequence[str] | None = None,
    seeds: Iterable[int] | None = None,
    rollouts: Iterable[int] | None = None,
    precision: str | None = None,
    resume: bool = False,
    address: str | None = None,
    threads: int = 1,
    memory: str | int = "1GiB",
    wait: bool = False,
    runtime_env: dict[str, Any] | None = None,
    verbose: bool = True,
) -> Row:
    """`optimise compare`, whose searches a Ray cluster does: what `--json` prints, a dictionary.

    Each search is saved as it goes on, every few minutes, so that a lost node, Ctrl-C or the end of this process cost no more.

    Args:
        scene: an embedded name or a TOML file; "bench" if None.
        out: the folder, new or without a comparison; `runs/<scene>-comparison`, numbered if taken, if None.
        methods, seeds, rollouts, precision: as the program's options; its defaults if None.
        resume: whether to go on with the comparison in `out`; with `rollouts`, to more than before.
        address, threads, memory, wait, runtime_env, verbose: as for `Campaign.run`, for each search.

    Raises:
        ImportError: there is no Ray.
        ValueError: what was asked for makes no sense as it stands; nothing was begun.
        ClusterError: the cluster cannot do it, is gone, or a search failed.
        KeyboardInterrupt: it was stopped.
    """
    if resume and out is None:
        raise ValueError("resume needs a folder to go on with: give it as out")
    words = [] if scene is None else [fspath(scene)]
    words += [] if out is None else ["--resume" if resume else "--out", fspath(out)]
    for name, listed in (("methods", methods), ("seeds", seeds), ("rollouts", rollouts)):
        words += [] if listed is None else [f"--{name}", ",".join(map(str, listed))]
    words += [] if precision is None else ["--precision", precision]
    return _compare(words, _Cluster("search", address, threads, memory, wait, runtime_env), Board(verbose))


def validate(
    scenes: Iterable[str | PathLike[str]],
    *,
    full: bool = False,
    write: str | PathLike[str] | None = None,
    address: str | None = None,
    threads: int = 1,
    memory: str | int = "1GiB",
    wait: bool = False,
    runtime_env: dict[str, Any] | None = None,
    verbose: bool = True,
) -> dict[str, Row]:
    """`optimise validate` of many scenes, each a task of a Ray cluster: for each scene what `--json` prints, a dictionary.

    Args:
        scenes: embedded names or TOML files.
        full: everything, stochastic lines with three seeds, instead of what can be measured within a minute.
        write: a folder into which each table goes as it comes, as `<scene>.json`.
        address, threads, memory, wait, runtime_env, verbose: as for `Campaign.run`, for each scene; memory is what its task asks the
            cluster for, and binds nobody.

    Raises:
        ImportError, ClusterError, KeyboardInterrupt: as `compare`.
        ValueError: a scene is none; nothing was begun.
    """
    names = [fspath(scene) for scene in scenes]
    cluster = _Cluster("table", address, threads, memory, wait, runtime_env)
    return _validate(names, full, None if write is None else Path(write), cluster, Board(verbose))


class _Cluster:
    """What is asked of it."""

    def __init__(
        self, noun: str, address: str | None, threads: int, memory: str | int, wait: bool, runtime_env: dict[str, Any] | None
    ) -> None:
        what = {"search": "compare", "table": "validate"}[noun]
        need_ray(f"to {what}", f"optimise {what}")
        self.noun, self.address = noun, address or connected()
        self.threads, self.memory_bytes = _native.checked_resources(threads, memory)
        self.wait, self.runtime_env = wait, runtime_env

    def job(self, command: list[str], files: dict[str, str], cases: list[tuple[int, str]]) -> dict[str, Any]:
        """For `_tasks`: the command for each case, in a folder with these files."""
        of_task = {
            "noun": self.noun,
            "command": command,
            "slice_s": SLICE_S,
            "files": list(files.items()),
            "threads": self.threads,
            "memory_bytes": self.memory_bytes,
            "version": _native.__version__,
            "storage": None,
        }
        job = {"address": self.address, "wait": self.wait, "runtime_env": self.runtime_env, "of_task": of_task}
        return {**job, "cases": cases, "begun": {}}

    def again(self, words: list[str]) -> str:
        """How to go on."""
        place = ["--address", self.address] if self.address else []
        return shlex.join(["python", "-m", "powderline.cluster", *place, *words])


class _Each(Driver):
    """Cases by name, each a command."""

    def __init__(self, names: list[str], board: Board, noun: str, into: str) -> None:
        super().__init__(board, noun, into)
        self.names = names
        self.failures: list[str] = []

    def failed(self, what: dict[str, Any]) -> None:
        words = f"{self.names[what['index']]}: {what['why']}"
        self.failures.append(words)
        self.board.done(what["index"], "failed", words)

    def refuse_failures(self) -> None:
        if self.failures:
            raise ClusterError(f"{count(len(self.failures), self.noun)} failed; the first: {self.failures[0]}")


class _Searches(_Each):
    """Searches of the comparison in a folder."""

    def __init__(self, folder: Path, names: list[str], board: Board) -> None:
        super().__init__(names, board, "search", str(folder))
        self.folder = folder

    def done(self, what: dict[str, Any]) -> None:
        self.kept(what)
        self.board.done(what["index"], "done", f"{self.names[what['index']]} is done, on {what['node']}")

    def kept(self, what: dict[str, Any]) -> None:
        """A search's folder is that which it had before or this one, whole."""
        folder = self.folder / self.names[what["index"]]
        fresh = folder.with_name(folder.name + FRESH)
        shutil.rmtree(fresh, ignore_errors=True)
        fresh.mkdir()
        for name, contents in what["files"]:
            if name != "stdout":
                (fresh / name).write_bytes(contents)
        former = folder.with_name(folder.name + FORMER)
        shutil.rmtree(former, ignore_errors=True)
        if folder.exists():
            folder.rename(former)
        fresh.rename(folder)
        shutil.rmtree(former, ignore_errors=True)

    def begun(self) -> dict[int, Files]:
        """What there is to go on from."""
        folders = {index: self.folder / name for index, name in enumerate(self.names)}
        for folder in folders.values():
            former = folder.with_name(folder.name + FORMER)
            if former.exists() and not folder.exists():
                # Somebody was killed right between the two.
                former.rename(folder)
        return {index: files_of(folder) for index, folder in folders.items() if (folder / "state").exists()}


class _Tables(_Each):
    """Tables of how true the powders of scenes are."""

    def __init__(self, names: list[str], write: Path | None, board: Board) -> None:
        super().__init__(names, board, "table", "memory" if write is None else str(write))
        self.folder = write
        self.tables: dict[str, Row] = {}

    def done(self, what: dict[str, Any]) -> None:
        name = self.names[what["index"]]
        text = dict(what["files"])["stdout"]
        self.tables[name] = json.loads(text)
        if self.folder is not None:
            self.folder.mkdir(parents=True, exist_ok=True)
            (self.folder / f"{Path(name).stem}.json").write_bytes(text)
        self.board.done(what["index"], "done", f"{name}: {self.tables[name]['summary']}")


def _compare(words: list[str], cluster: _Cluster, board: Board) -> Row:
    limits = ["--threads", str(cluster.threads), "--memory", str(cluster.memory_bytes)]
    prepared = _program(["compare", *words, *limits, "--prepare"])
    folder, left = Path(prepared["folder"]), prepared["left"]
    files = {name: (folder / name).read_text(encoding="utf-8") for name in ("scene.toml", "comparison.json")}
    searches = _Searches(folder, left, board)
    board.begin([{"case": name, "bench": name.rsplit("-", 1)[0], "powder": None} for name in left], [], len(left))
    job = cluster.job(["compare", "--resume", ".", *limits, "--json", "--only"], files, list(enumerate(left)))
    try:
        if left:
            searches.have_done({**job, "begun": searches.begun()})
        searches.refuse_failures()
    except (KeyboardInterrupt, ClusterError) as error:
        again = cluster.again(["compare", "--resume", str(folder)])
        raise type(error)(f"{str(error) or STOPPED}; what is done is saved, go on with: {again}") from None
    finally:
        board.clear()
    return _program(["compare", "--resume", str(folder), *limits])


def _validate(names: list[str], full: bool, write: Path | None, cluster: _Cluster, board: Board) -> dict[str, Row]:
    # The name of a scene that came with the program says which one it is.
    files = {f"{index}.toml": Scene.load(name).to_toml() for index, name in enumerate(names)}
    stems = [Path(name).stem for name in names]
    twice = next((name for name, stem in zip(names, stems) if stems.count(stem) > 1), None)
    if twice is not None:
        raise ValueError(f"two of the scenes are called like {twice}; give each once")
    tables = _Tables(names, write, board)
    board.begin([{"case": name, "bench": "scenes", "powder": None} for name in names], [], len(names))
    command = ["validate", "--full" if full else "--short", "--threads", str(cluster.threads), "--json"]
    try:
        tables.have_done(cluster.job(command, files, list(enumerate(files))))
        tables.refuse_failures()
    finally:
        board.clear()
    return {name: tables.tables[name] for name in names}


def _program(words: list[str]) -> Row:
    """What a command of `optimise` prints with `--json`."""
    done = subprocess.run([*PROGRAM, *words, "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        found: Row = json.loads(done.stdout)
    except ValueError:
        raise SimulationError(done.stderr.decode("utf-8", "replace").strip() or f"it ended with {done.returncode}") from None
    if "error" in found:
        raise (ValueError if found["exit_code"] == 2 else SimulationError)(found["error"])
    return found


def _parsed(arguments: list[str] | None) -> tuple[argparse.Namespace, list[str]]:
    parser = argparse.ArgumentParser(
        prog="python -m powderline.cluster",
        description="Run long commands of `optimise` on a Ray cluster, each search or scene a task.",
        epilog="Many ordinary runs are a campaign: python -m powderline.campaign.",
    )
    add = parser.add_argument
    add("--address", help="of the cluster, such as 10.0.0.1:6379 or auto [default: $RAY_ADDRESS, or this machine alone]")
    add("--threads", metavar="N", type=int, default=1, help="threads of each search or scene [default: 1]")
    add("--memory", metavar="SIZE", default="1GiB", help="most memory that each may hold [default: 1GiB]")
    add("--wait", action="store_true", help="wait for nodes where none has so many CPUs and so much memory yet")
    add("--json", action="store_true", help="print what came of it as one JSON object")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    commands.add_parser("compare", add_help=False, help="searches side by side, with the options of `optimise compare`")
    tables = commands.add_parser("validate", help="how true the powders of scenes are")
    tables.add_argument("scenes", metavar="SCENE", nargs="+", help="an embedded name or a TOML file")
    scope = tables.add_mutually_exclusive_group()
    scope.add_argument("--short", action="store_true", help="what can be measured within a minute (the default)")
    scope.add_argument("--full", action="store_true", help="everything, stochastic lines with three seeds")
    tables.add_argument("--write", metavar="DIR", type=Path, help="also write each table into this folder, as <scene>.json")
    given, words = parser.parse_known_args(arguments)
    if words and given.command != "compare":
        parser.error(f"unrecognized arguments: {shlex.join(words)}")
    return given, words


def _command(given: argparse.Namespace, words: list[str]) -> int:
    """Runs what the arguments ask for; returns the exit code."""
    if given.command == "compare" and {"-h", "--help"} & set(words):
        return subprocess.call([*PROGRAM, "compare", "--help"])
    noun = "search" if given.command == "compare" else "table"
    cluster = _Cluster(noun, given.address, given.threads, given.memory, given.wait, None)
    if given.command == "compare":
        found = _compare(words, cluster, Board(True))
        folder = Path(found["folder"])
        print(json.dumps(found) if given.json else f"\n{(folder / 'summary.md').read_text()}\nThe figure is in {folder}/curves.svg.")
        return 0
    tables = _validate(given.scenes, given.full, given.write, cluster, Board(True))
    print(json.dumps(tables) if given.json else "\n".join(f"{name}: {table['summary']}" for name, table in tables.items()))
    failures = [f"{name}: {table['failure']}" for name, table in tables.items() if table["failure"]]
    print("\n".join(failures), end="\n" if failures else "", file=sys.stderr)
    return 1 if failures else 0


def main(arguments: list[str] | None = None) -> int:
    """The program `python -m powderline.cluster`."""
    given, words = _parsed(arguments)
    return of_shell(lambda: _command(given, words), given.json)


if __name__ == "__main__":
    sys.exit(main())
