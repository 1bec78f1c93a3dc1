"""What has a Ray cluster do things, and says how that goes: beside `_tasks`, which speaks to Ray in a process of its own."""

from __future__ import annotations

import importlib.util
import json
import pickle
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import IO, Any, Callable, Iterator

from ._native import SimulationError

#: From one time that what came of it is written to the next, at least, seconds.
WRITE_S = 60.0
#: From one look at the terminal to the next, seconds, and from one table of a log to the next.
DRAW_S, LOG_S = 0.5, 60.0
#: How long a cluster may take to answer before that is said, seconds.
WAIT_S = 20.0
#: Most rows of the table that is shown while cases are done.
MAX_GROUPS = 12
#: Statuses in the order in which a person asks for them.
STATUSES = ("failed", "missed", "done", "met")
#: What is said of Ctrl-C.
STOPPED = "stopped on request"

#: The program `optimise`.
PROGRAM = [sys.executable, "-m", "powderline"]
#: A file of a case that only says that somebody is writing.
LOCK = "lock"

Row = dict[str, Any]
Files = list[tuple[str, bytes]]


class ClusterError(SimulationError):
    """The cluster cannot do what it is to do, or is gone. What is done is saved."""


class Driver:
    """Has a cluster do what there is to do, each a `noun`, and takes in what comes of it."""

    def __init__(self, board: Board, noun: str, into: str) -> None:
        self.board, self.noun, self.into = board, noun, into

    def done(self, what: dict[str, Any]) -> None:
        """What one has left behind: `index`, `files`, and the `node`."""
        raise NotImplementedError

    def failed(self, what: dict[str, Any]) -> None:
        """One has come to nothing: `index`, and `why`."""
        raise NotImplementedError

    def kept(self, what: dict[str, Any]) -> None:
        """One has come this far, from where it goes on: as for `done`."""

    def write(self) -> None:
        """Writes what is of all."""

    def have_done(self, job: dict[str, Any]) -> None:
        """Has these cases done, and takes in what comes of them."""
        began = written = time.monotonic()
        link = Link(job)
        try:
            answered = False
            for kind, what in link:
                if not answered and time.monotonic() - began > WAIT_S:
                    self.board.line(f"{where(job['address'])} has not answered yet")
                    answered = True
                answered = answered or kind != "nothing"
                if kind == "finished":
                    self.board.clear()
                    self.board.line(f"{count(len(job['cases']), self.noun)} in {time.monotonic() - began:.1f} s")
                    return
                self.hear(kind, what)
                if time.monotonic() - written >= WRITE_S:
                    self.write()
                    written = time.monotonic()
            raise ClusterError(link.last_words(job["address"]))
        except KeyboardInterrupt:
            # What has come to its end in the meantime is not thrown away.
            link.stop()
            for kind, what in link:
                if kind in ("done", "failed", "kept"):
                    self.hear(kind, what)
            raise
        finally:
            link.close()

    def hear(self, kind: str, what: dict[str, Any]) -> None:
        board = self.board
        if kind == "done":
            self.done(what)
        elif kind == "failed":
            self.failed(what)
        elif kind == "kept":
            self.kept(what)
        elif kind == "cluster":
            nodes, cpus = count(what["nodes"], "node"), count(what["cpus"], "CPU")
            board.line(f"{nodes} with {cpus}: {count(what['slots'], self.noun)} at a time, into {self.into}")
        elif kind == "again":
            board.line(f"{count(what['count'], self.noun)} to be done again: {what['why']}")
        elif kind == "silent":
            board.line("the head of the cluster does not answer; what was begun goes on for a while")
        elif kind == "heard":
            board.line("the head of the cluster answers again")
        elif kind in ("refused", "broken"):
            raise ClusterError(what["why"])
        board.draw()


class Link:
    """The process that is connected to the cluster, see `_tasks`: what it tells, a pair of a word and a dictionary each."""

    def __init__(self, job: dict[str, Any]) -> None:
        self.errors: IO[bytes] = tempfile.TemporaryFile()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "powderline._tasks"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.errors,
            # Ctrl-C is for this process, which asks that one to stop.
            start_new_session=True,
        )
        self.heard: queue.Queue[tuple[str, dict[str, Any]] | None] = queue.Queue(maxsize=64)
        self.open = True
        threading.Thread(target=self.listen, daemon=True).start()
        assert self.process.stdin is not None
        try:
            pickle.dump(job, self.process.stdin)
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # It has said why.

    def listen(self) -> None:
        assert self.process.stdout is not None
        try:
            while self.open:
                self.heard.put(pickle.load(self.process.stdout))
        except (EOFError, pickle.UnpicklingError, OSError, ValueError):
            pass
        self.heard.put(None)

    def __iter__(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """What is told, and now and then nothing, until the process is gone."""
        while True:
            try:
                told = self.heard.get(timeout=DRAW_S)
            except queue.Empty:
                yield "nothing", {}
                continue
            if told is None:
                return
            yield told

    def stop(self) -> None:
        """Asks it to come to an end."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.close()
        except BrokenPipeError:
            pass

    def close(self) -> None:
        self.open = False
        self.stop()
        while self.process.poll() is None:
            # It may still have something to say.
            try:
                self.heard.get(timeout=0.1)
            except queue.Empty:
                pass
        self.errors.close()

    def last_words(self, address: str | None) -> str:
        """Why it is gone."""
        self.process.wait()
        self.errors.seek(0)
        lines = [line.strip() for line in self.errors.read().decode("utf-8", "replace").splitlines()]
        last = next((line for line in reversed(lines) if line), f"exit code {self.process.returncode}")
        return f"{where(address)} is gone; its head has ended, or the node by which this machine is connected ({last})"


class Board:
    """What is said on standard error: a line for each case, and below them, on a terminal, a table of how far all are."""

    def __init__(self, verbose: bool) -> None:
        self.verbose = verbose
        self.live = verbose and sys.stderr.isatty()
        self.drawn = 0
        self.when = time.monotonic()
        self.began = self.when
        self.groups: list[str] = []
        self.of_case: list[int] = []
        self.counts: list[Counter[str]] = []
        self.finished = self.all = 0

    def begin(self, cases: list[Row], outcomes: list[Row], left: int) -> None:
        """So many cases are left to be done."""
        self.began, self.all = time.monotonic(), left
        places: dict[str, int] = {}
        for row in cases:
            name = row["bench"] if row["powder"] is None else f"{row['bench']}, {row['powder']}"
            self.of_case.append(places.setdefault(name, len(places)))
        self.groups = list(places)
        self.counts = [Counter() for _ in places]
        for place in self.of_case:
            self.counts[place]["cases"] += 1
        number = {row["case"]: index for index, row in enumerate(cases)}
        for row in outcomes:
            # What failed is done again.
            if row["status"] != "failed":
                self.counts[self.of_case[number[row["case"]]]][row["status"]] += 1

    def done(self, index: int, status: str, words: str) -> None:
        self.finished += 1
        self.counts[self.of_case[index]][status] += 1
        self.line(f"[{self.finished}/{self.all}] {words}")

    def line(self, text: str) -> None:
        """A line that stays."""
        if self.verbose:
            self.clear()
            print(text, file=sys.stderr, flush=True)

    def draw(self) -> None:
        """The table, if it is time."""
        now = time.monotonic()
        if not self.verbose or not self.counts or now - self.when < (DRAW_S if self.live else LOG_S):
            return
        self.clear()
        self.when = now
        columns = shutil.get_terminal_size().columns - 1 if self.live else 200
        lines = [line[:columns] for line in self.table(now)]
        print("\n".join(lines), file=sys.stderr, flush=True)
        self.drawn = len(lines) if self.live else 0

    def clear(self) -> None:
        """Takes the table away, so that something else comes in its place."""
        if self.drawn:
            print(f"\x1b[{self.drawn}A\x1b[J", end="", file=sys.stderr, flush=True)
        self.drawn = 0
        if self.live:
            # It is drawn again at the next chance.
            self.when = min(self.when, time.monotonic() - DRAW_S) if self.counts else self.when

    def table(self, now: float) -> Iterator[str]:
        statuses = [status for status in STATUSES if any(counts[status] for counts in self.counts)]
        wide = max(map(len, ("all", *self.groups[:MAX_GROUPS])))
        heads = ["cases", *statuses, "open"]
        yield f"{'':{wide}}" + "".join(f"  {head:>7}" for head in heads)
        total: Counter[str] = Counter()
        for place, (name, counts) in enumerate(zip(self.groups, self.counts)):
            total.update(counts)
            if place < MAX_GROUPS:
                yield self.row(name, wide, counts, statuses)
        if len(self.groups) > 1:
            yield self.row("all", wide, total, statuses)
        if self.finished:
            left_s = (now - self.began) / self.finished * (self.all - self.finished)
            yield f"about {left_s / 60:.0f} min left" if left_s >= 90 else f"about {left_s:.0f} s left"

    @staticmethod
    def row(name: str, wide: int, counts: Counter[str], statuses: list[str]) -> str:
        of_status = [counts[status] for status in statuses]
        numbers = [counts["cases"], *of_status, counts["cases"] - sum(counts[status] for status in STATUSES)]
        return f"{name:{wide}}" + "".join(f"  {number:>7}" for number in numbers)


def files_of(folder: Path) -> Files:
    """What a case has left behind, what became of it last: it says that the rest is there."""
    files = [file for file in folder.iterdir() if file.is_file() and file.name != LOCK]
    files.sort(key=lambda file: (file.name == "outcome.json", file.name))
    return [(file.name, file.read_bytes()) for file in files]


def file_system(address: str, options: dict[str, Any]) -> tuple[Any, str]:
    """The file system of an address, by fsspec, and the path in it."""
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise ImportError('an address needs fsspec; install it by: pip install "powderline[campaign]"') from None
    try:
        system, root = url_to_fs(address, **options)
    except (ImportError, ValueError) as error:
        raise ValueError(f"{address} is no address that fsspec can use: {error}") from None
    return system, root.rstrip("/")


def count(number: int, what: str) -> str:
    plural = "es" if what.endswith("ch") else "s"
    return f"{number:,} {what}{'' if number == 1 else plural}"


def where(address: str | None) -> str:
    """The cluster, in words."""
    return f"the Ray cluster at {address}" if address else "the Ray cluster"


def connected() -> str | None:
    """Address of the cluster that this process uses already."""
    ray = sys.modules.get("ray")
    if ray is None or not ray.is_initialized():
        return None
    return str(ray.get_runtime_context().gcs_address)


def of_shell(command: Callable[[], int], as_json: bool) -> int:
    """Runs what a shell asked for: its exit code, as the program `optimise` has them, with one sentence where it came to nothing."""

    def stopped(signal_number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    def failed(sentence: str, code: int) -> int:
        if as_json:
            print(json.dumps({"error": sentence, "exit_code": code}))
        print(sentence, file=sys.stderr)
        return code

    signal.signal(signal.SIGTERM, stopped)
    # What a shell starts in the background does not hear it otherwise.
    signal.signal(signal.SIGINT, stopped)
    try:
        return command()
    except KeyboardInterrupt as error:
        return failed(str(error) or STOPPED, 130)
    except (ValueError, ImportError) as error:
        return failed(str(error), 2)
    except (SimulationError, OSError) as error:
        return failed(str(error), 1)


def need_ray(what: str, without: str) -> None:
    """Raises ImportError where there is no Ray."""
    if importlib.util.find_spec("ray") is None:
        raise ImportError(
            f'{what} on a cluster needs Ray; install it by: pip install "powderline[campaign]". On one machine the program does the same '
            f"without: {without}"
        )
