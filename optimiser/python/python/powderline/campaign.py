"""Many cases on many machines: a campaign's file, as `optimise campaign FILE` has it, on a Ray cluster.

    from powderline.campaign import Campaign

    campaign = Campaign.load("doses.toml")              # benches, powders, amounts and seeds, each combined with each
    campaign.cases                                      # a dictionary for each case
    campaign.check()                                    # raises ValueError, with a line for each case that cannot be done
    result = campaign.run("runs/doses")                 # on this machine; on a cluster: address="10.0.0.1:6379"
    result.show()                                       # what came of it, the worst cases first
    result.table                                        # all of it, as pandas.read_parquet gives it

The same from a shell, with the options and words of `optimise campaign`:

    python -m powderline.campaign doses.toml --address 10.0.0.1:6379
    python -m powderline.campaign --resume runs/doses --address 10.0.0.1:6379

It needs Ray (`pip install "powderline[campaign]"`), and each node this version of powderline. On one machine `optimise campaign FILE`
does the same without Ray, and even without Python, to the same bytes; either goes on with what the other has begun.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import sys
import tempfile
from collections import Counter
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Iterator

from . import _native
from ._driver import STOPPED, Board, ClusterError, Driver, connected, count, file_system, need_ray, of_shell
from ._native import Plan, Scene

Row = dict[str, Any]


class Campaign:
    """Benches, powders, amounts, draws and seeds, each combined with each.

    Attributes:
        name: the campaign's name.
        cases: a dictionary for each case: `case` (its name, and its folder's), `bench`, `powder`, `amount_kg`, `draw`, `seed`.
    """

    def __init__(self, native: _native.Campaign) -> None:
        self._native = native

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Campaign:
        """The campaign of a TOML file, or the one that a folder or an address of results was begun with.

        Raises:
            ValueError: one sentence, about the file or a bench.
        """
        text = fspath(path)
        if is_address(text):
            with tempfile.TemporaryDirectory(prefix="powderline-") as copy:
                Address(text, {}).fetch(Path(copy), outcomes=False)
                return cls(_native.Campaign.load(Path(copy) / "campaign.toml"))
        folder = Path(text)
        return cls(_native.Campaign.load(folder / "campaign.toml" if folder.is_dir() else folder))

    @property
    def name(self) -> str:
        return self._native.name

    @property
    def cases(self) -> list[Row]:
        return [self._native.case(index) for index in range(len(self))]

    def __len__(self) -> int:
        return len(self._native)

    def __repr__(self) -> str:
        return f"Campaign({self.name!r}: {count(len(self), 'case')})"

    def check(self, *, threads: int = 1, memory: str | int = "1GiB") -> None:
        """Looks at every case: whether it can be done, with so many threads and so much memory. `run` does that first, too.

        Raises:
            ValueError: says which cases cannot be done, and why.
        """
        self._native.check(threads, memory)

    def run(
        self,
        out: str | PathLike[str] | None = None,
        *,
        resume: bool = False,
        address: str | None = None,
        threads: int = 1,
        memory: str | int = "1GiB",
        wait: bool = False,
        runtime_env: dict[str, Any] | None = None,
        storage_options: dict[str, Any] | None = None,
        verbose: bool = True,
    ) -> Result:
        """Has the cases done by a Ray cluster: a `Result`.

        A case is a run like any other, in a process of its own on some node, and what it comes to is the same wherever that is. What is
        done is saved as it comes. Where a node is lost, what it was at is done again elsewhere; a case that fails says why, and does
        not stop the others. Ctrl-C stops it. `resume=True` goes on, with what is not done yet and what failed.

        Args:
            out: where results go, new or without a campaign: a folder, or an address that fsspec knows, such as "s3://bucket/doses",
                to which nodes write by themselves; `runs/<name>`, numbered if taken, if None.
            resume: whether to go on with what is there; the campaign may have more cases than before.
            address: of a cluster, as `ray.init` takes it; that which this process is connected to, or $RAY_ADDRESS, or this machine
                alone, if None.
            threads: that each case has, and that its task asks for.
            memory: the most that each case may take, and that its task asks for, such as "2GiB" or a number of bytes.
            wait: whether to wait where no node has as much: for clusters that grow when asked to.
            runtime_env: what Ray is to prepare on nodes, such as {"pip": ["powderline"]}.
            storage_options: what fsspec needs for `out`, such as {"endpoint_url": ..}.
            verbose: whether to write to `sys.stderr` how it goes.

        Raises:
            ImportError: there is no Ray.
            ValueError: what was asked for makes no sense as it stands; nothing was begun.
            ClusterError: the cluster cannot do it, or is gone.
            KeyboardInterrupt: it was stopped.
        """
        need_ray("a campaign", "optimise campaign FILE")
        board = Board(verbose)
        board.line(f"{self.name}: {count(len(self), 'case')}")
        memory_bytes = self._native.check(threads, memory)
        if resume and out is None:
            raise ValueError("resume needs a folder to go on with, or an address: give it as out")
        place = Place.of(out, storage_options or {})
        of_task = {
            "noun": "case",
            "command": None,
            "files": self._native.files(),
            "threads": threads,
            "memory_bytes": memory_bytes,
            "version": _native.__version__,
            "storage": place.storage,
        }
        cluster = {"address": address or connected(), "wait": wait, "runtime_env": runtime_env, "of_task": of_task}
        try:
            session = Session(self, place, place.open(self._native, resume), board)
            try:
                session.work(cluster)
                return Result(place, session.folder, self)
            finally:
                # Whoever keeps what was raised here, as notebooks do, would keep the folder locked.
                del session.folder
        finally:
            board.clear()
            place.close()


class Result:
    """What came of a campaign.

    Attributes:
        folder: where it is, a folder or an address.
        verdict: what is to be known first, in one sentence.
        cases: a dictionary for each case that came to its end, as in `Campaign.cases`, with `status` ("met", "missed", "failed" or
            "done"), `error`, and, unless it failed, `wanted_kg`, `mass_kg`, `miss`, `lost_kg`, `loss_m`, `theta`.
        exit_code: as the program's: 0, 1 if a case failed, 3 if one missed.
        failure: what the program would say at last, None with 0.
    """

    def __init__(self, place: Place, folder: _native.CampaignFolder, campaign: Campaign) -> None:
        self.folder = place.name
        self.verdict = folder.verdict()
        self.cases: list[Row] = folder.outcomes()
        self.exit_code, self.failure = folder.judged()
        self._storage = place.storage

    @property
    def table(self) -> Any:
        """All cases, a row each, with every number: what `pandas.read_parquet` gives, or `pyarrow.parquet.read_table` without pandas."""
        path = f"{self.folder}/table.parquet"
        options = self._storage[1] if self._storage else None
        try:
            import pandas

            return pandas.read_parquet(path, storage_options=options or None)
        except ImportError:
            pass
        try:
            import pyarrow.parquet
        except ImportError:
            raise ImportError(f"to read {path}, pandas or pyarrow is needed; install it by: pip install pandas pyarrow") from None
        if self._storage is None:
            return pyarrow.parquet.read_table(path)
        system, root = file_system(*self._storage)
        return pyarrow.parquet.read_table(f"{root}/table.parquet", filesystem=system)

    def plan(self, case: str) -> Plan:
        """The plan of a case's search, by the case's name."""
        scene = Scene.from_toml(self._read(f"cases/{case}/scene.toml").decode())
        return Plan.from_bytes(self._read(f"cases/{case}/skill.plan"), scene)

    def _read(self, file: str) -> bytes:
        if self._storage is None:
            return (Path(self.folder) / file).read_bytes()
        system, root = file_system(*self._storage)
        return bytes(system.cat_file(f"{root}/{file}"))

    def show(self, rows: int = 20) -> None:
        """Prints what came of it, and so many cases, the worst first."""
        print(self.verdict)
        for line in self._rows(rows):
            print(line)

    def _rows(self, rows: int) -> Iterator[str]:
        worst = sorted(self.cases, key=lambda row: -abs(row.get("miss", float("inf"))))
        wide = max((len(row["case"]) for row in worst[:rows]), default=4)
        yield f"{'case':{wide}}  {'wanted':>10}  {'arrives':>10}  {'miss':>8}  status"
        for row in worst[:rows]:
            if "miss" in row:
                numbers = f"{1e3 * row['wanted_kg']:>8.4g} g  {1e3 * row['mass_kg']:>8.4g} g  {100 * row['miss']:>+6.1f} %"
            else:
                numbers = f"{'-':>10}  {'-':>10}  {'-':>8}"
            error = f": {row['error']}" if row["error"] else ""
            yield f"{row['case']:{wide}}  {numbers}  {row['status']}{error}"
        if len(worst) > rows:
            yield f"and {len(worst) - rows} more"

    def __repr__(self) -> str:
        return f"Result({self.folder!r}: {self.verdict})"


class Session(Driver):
    """What there is to do, until it is done."""

    def __init__(self, campaign: Campaign, place: Place, folder: _native.CampaignFolder, board: Board) -> None:
        super().__init__(board, "case", place.name)
        self.campaign, self.place, self.folder = campaign, place, folder

    def work(self, cluster: dict[str, Any]) -> None:
        """Does what is left."""
        left, everything = self.folder.left(), len(self.campaign)
        try:
            if not left:
                self.board.line(f"all of {self.place.name} are done")
            else:
                if len(left) < everything:
                    self.board.line(f"{everything - len(left)} are done already")
                self.board.begin(self.campaign.cases, self.folder.outcomes(), len(left))
                named = [(index, self.campaign._native.case(index)["case"]) for index in left]
                self.have_done({**cluster, "cases": named, "begun": {}})
        except (KeyboardInterrupt, ClusterError) as error:
            again = self.place.again(cluster["address"])
            raise type(error)(f"{str(error) or STOPPED}; what is done is saved, go on with: {again}") from None
        finally:
            self.board.clear()
            self.write()

    def done(self, what: dict[str, Any]) -> None:
        try:
            status, words = self.folder.deliver(what["index"], what["files"])
        except ValueError as error:
            raise ClusterError(f"{what['node']} has another version of powderline: {error}") from None
        self.board.done(what["index"], status, words)

    def failed(self, what: dict[str, Any]) -> None:
        status, words = self.folder.fail(what["index"], what["why"])
        self.place.keep(Path("cases", self.campaign._native.case(what["index"])["case"], "outcome.json"))
        self.board.done(what["index"], status, words)

    def write(self) -> None:
        self.folder.write()
        self.place.publish()


class Place:
    """Where results go: a folder."""

    #: Address and options of fsspec, where nodes write by themselves.
    storage: tuple[str, dict[str, Any]] | None = None

    def __init__(self, out: str | None) -> None:
        self.out = out
        self.name = out or ""

    @staticmethod
    def of(out: str | PathLike[str] | None, options: dict[str, Any]) -> Place:
        text = None if out is None else fspath(out)
        if text is not None and is_address(text):
            return Address(text, options)
        if text is not None and Path(text).is_file():
            raise ValueError(f"out is {text!r}, which is a file; give a folder, new or without a campaign")
        return Place(text)

    def open(self, campaign: _native.Campaign, resume: bool) -> _native.CampaignFolder:
        """The folder in which outcomes are kept."""
        if resume:
            folder = _native.CampaignFolder.open(campaign, self.name)
        else:
            folder = _native.CampaignFolder.start(campaign, self.out)
        self.name = fspath(folder.path)
        return folder

    def again(self, cluster: str | None) -> str:
        """What goes on with what is there, in words."""
        words = ["python", "-m", "powderline.campaign", "--resume", self.name]
        return shlex.join(words + (["--address", cluster] if cluster else []))

    def keep(self, file: Path) -> None:
        """A file of the folder is new."""

    def publish(self) -> None:
        """Table and page are new."""

    def close(self) -> None:
        """Nothing more will come."""


class Address(Place):
    """Where results go: an address of fsspec. Of what nodes write there, a folder here has no more than each case's outcome."""

    def __init__(self, out: str, options: dict[str, Any]) -> None:
        super().__init__(out.rstrip("/"))
        self.storage: tuple[str, dict[str, Any]] = (self.name, options)
        self.copy = tempfile.TemporaryDirectory(prefix="powderline-")
        self.folder = Path(self.copy.name) / "campaign"

    def again(self, cluster: str | None) -> str:
        # A command line has no place for options, which may be secrets.
        if not self.storage[1]:
            return super().again(cluster)
        address = f", address={cluster!r}" if cluster else ""
        return f"campaign.run({self.name!r}, resume=True, storage_options=..{address})"

    def fetch(self, into: Path, outcomes: bool) -> None:
        """The campaign as it was begun there, and what became of its cases."""
        system, root = file_system(*self.storage)
        system.invalidate_cache()
        if not system.exists(f"{root}/campaign.toml"):
            raise ValueError(f"{self.name} holds nothing to resume (there is no campaign.toml file in it)")
        wanted = [f"{root}/campaign.toml", *system.glob(f"{root}/benches/*.toml")]
        if outcomes:
            wanted += system.glob(f"{root}/cases/*/outcome.json")
        # Of several at once for file systems that can.
        found = system.cat(wanted)
        for path, contents in found.items():
            at = into / path[path.index(root) + len(root) :].lstrip("/")
            at.parent.mkdir(parents=True, exist_ok=True)
            at.write_bytes(contents)

    def open(self, campaign: _native.Campaign, resume: bool) -> _native.CampaignFolder:
        system, root = file_system(*self.storage)
        if resume:
            self.fetch(self.folder, outcomes=True)
            folder = _native.CampaignFolder.open(campaign, self.folder)
        elif system.exists(f"{root}/campaign.toml"):
            raise ValueError(
                f"{self.name} already holds a campaign, which is not overwritten; choose another --out, or go on with it by --resume "
                f"{self.name}"
            )
        else:
            folder = _native.CampaignFolder.start(campaign, self.folder)
        for file in [*self.folder.glob("benches/*.toml"), self.folder / "campaign.toml"]:
            self.keep(file.relative_to(self.folder))
        return folder

    def keep(self, file: Path) -> None:
        system, root = file_system(*self.storage)
        place = f"{root}/{file.as_posix()}"
        system.makedirs(place.rsplit("/", 1)[0], exist_ok=True)
        system.pipe_file(place, (self.folder / file).read_bytes())

    def publish(self) -> None:
        self.keep(Path("table.parquet"))
        self.keep(Path("report.html"))

    def close(self) -> None:
        self.copy.cleanup()


def is_address(out: str) -> bool:
    return re.match(r"[A-Za-z][A-Za-z0-9+.-]+(::[A-Za-z].*)?://", out) is not None


def parsed(arguments: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m powderline.campaign",
        description="Run many cases on a Ray cluster: benches, powders, amounts and seeds, each combined with each.",
        epilog="Exit codes are those of `optimise`, which does the same on one machine: optimise campaign FILE.",
    )
    add = parser.add_argument
    add("file", metavar="FILE", nargs="?", help="the campaign, a TOML file")
    add("--address", help="of the cluster, such as 10.0.0.1:6379 or auto [default: $RAY_ADDRESS, or this machine alone]")
    add("--out", metavar="DIR", help="folder or address (s3://..) to write to [default: runs/<campaign>, numbered if taken]")
    add("--resume", metavar="DIR", help="go on with the campaign there; with FILE, which may have more cases than before")
    add("--check", action="store_true", help="only check it: nothing is begun")
    add("--threads", metavar="N", type=int, default=1, help="threads of each case [default: 1]")
    add("--memory", metavar="SIZE", default="1GiB", help="most memory that each case may hold [default: 1GiB]")
    add("--wait", action="store_true", help="wait for nodes where none has so many CPUs and so much memory yet")
    add("--json", action="store_true", help="print what came of it as one JSON object")
    given = parser.parse_args(arguments)
    if given.file is None and given.resume is None:
        parser.error("FILE is missing: the campaign, a TOML file")
    if given.resume is not None and (given.out is not None or given.check):
        parser.error("--resume goes with neither --out nor --check")
    return given


def command(given: argparse.Namespace) -> int:
    """Runs what the arguments ask for; returns the exit code."""
    campaign = Campaign.load(given.file or given.resume)
    if given.check:
        campaign.check(threads=given.threads, memory=given.memory)
        each = f"with {count(given.threads, 'thread')} and {given.memory} each"
        print(json.dumps({"folder": None, "cases": len(campaign)}) if given.json else f"{campaign.name} can be run: {each}.")
        return 0
    result = campaign.run(
        given.resume or given.out,
        resume=given.resume is not None,
        address=given.address,
        threads=given.threads,
        memory=given.memory,
        wait=given.wait,
    )
    if given.json:
        counts = Counter(row["status"] for row in result.cases)
        report = {status: counts[status] for status in ("met", "missed", "done", "failed")}
        print(json.dumps({"folder": result.folder, "cases": len(campaign), **report}))
    else:
        print(f"\n{result.verdict}")
        print(f"The page is {result.folder}/report.html: open it in a browser. The table is {result.folder}/table.parquet.")
    if result.failure is not None:
        print(result.failure, file=sys.stderr)
    return result.exit_code


def main(arguments: list[str] | None = None) -> int:
    """The program `python -m powderline.campaign`."""
    given = parsed(arguments)
    return of_shell(lambda: command(given), given.json)


if __name__ == "__main__":
    sys.exit(main())
