"""What speaks to Ray: a process of its own beside the driver's, and the tasks on the nodes.

Ray ends the process that is connected to a cluster when the cluster's head is gone. So that a campaign, or a notebook, outlives
that, `_driver` starts this module as a program, tells it on its standard input what there is to do, and reads on its standard output
what came of it: pickles, one after another. When its input ends, so does this.

    campaign, cluster         python -m powderline._tasks              a node
    -------------------       -----------------------------------      ---------------------------------------------------
    what is to be done   ->   a task for some cases at a time     ->   the program `optimise`, in a process of its own, as on
    files of each case   <-   as they come, in any order          <-   one machine: `perform_cases`, or a command for each case

A command may be a search that saves each epoch: it is stopped now and then when it has just done so, and goes on in another task, so
that a node that is lost costs minutes.
"""

from __future__ import annotations

import ctypes
import json
import os
import pickle
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import Any, BinaryIO

import ray

from . import _native
from ._driver import PROGRAM, Files, count, file_system, files_of, where

#: How long a task is to take, seconds: longer than its process takes to begin by so many times, and no longer than a lost node may cost.
TASK_S, BEGINS, LONGEST_S = 5.0, 20.0, 30.0
#: Most cases of a task.
MAX_BATCH = 500
#: Most tasks that wait or run, as much of them as Ray and this process's memory hold with ease.
MAX_TASKS = 10_000
#: So often is a case begun that is lost with its node or its process of Ray's before it counts as failed.
MAX_TRIES = 10
#: How long a node that could do nothing waits before it is free for more, seconds: others take what there is meanwhile.
SICK_S = 5.0
#: From one look at the cluster to the next, seconds, and how long its head may be silent before that is said.
LOOK_S = 5.0
SILENT_S = 10.0
#: How long the address of a cluster may take to answer, seconds.
CONNECT_S = 10.0

#: From one look at a command to the next, seconds.
POLL_S = 0.1

Case = tuple[int, str]


class Unfit(Exception):
    """A node on which nothing can be done."""


class Failed(Exception):
    """What the program says of a command that came to nothing."""


# On a node.


def perform(job: dict[str, Any], cases: list[Case], begun: dict[int, Files]) -> dict[str, Any]:
    """Does some cases on this node, each a run like any other; what they come to is the same wherever that is. Of those that were begun
    before there are files to go on from."""
    node = ray.util.get_node_ip_address()
    if _native.__version__ != job["version"]:
        raise Unfit(f"{node} has powderline {_native.__version__}, but what it is to do is of {job['version']}")
    names, why, sick = dict(cases), None, None
    results: list[tuple[int, Files]] = []
    kept: list[tuple[int, Files]] = []
    ends: list[float] = []
    began = time.monotonic()

    def ended(index: int) -> None:
        folder = scratch / "cases" / names[index]
        files = files_of(folder)
        if job["storage"] is not None:
            system, root = file_system(*job["storage"])
            place = f"{root}/cases/{names[index]}"
            system.makedirs(place, exist_ok=True)
            for name, contents in files:
                system.pipe_file(f"{place}/{name}", contents)
            files = files[-1:]
        shutil.rmtree(folder)
        results.append((index, files))
        ends.append(time.monotonic())

    try:
        with tempfile.TemporaryDirectory(prefix="powderline-campaign-", ignore_cleanup_errors=True) as folder:
            scratch = Path(folder)
            write_files(scratch, [(name, text.encode()) for name, text in job["files"]])
            if job["command"] is None:
                _native.perform_cases(str(scratch), list(names), job["threads"], job["memory_bytes"], PROGRAM, ended)
            for index, name in cases if job["command"] is not None else []:
                write_files(scratch / name, begun.get(index, []))
                files, is_whole = run_command(job, scratch, name)
                (results if is_whole else kept).append((index, files))
                ends.append(time.monotonic())
    except Failed as error:
        why = str(error)
    except (OSError, _native.SimulationError) as error:  # What a case itself fails of is its outcome: this is the node, or the storage.
        sick = f"on {node}: {error}"
    except Exception as error:  # Whatever it is, it is said of the case, and the others go on.
        why = f"{type(error).__name__}: {error}"
    # The first one's time has that in it which the process takes to begin.
    case_s = (ends[-1] - ends[0]) / (len(ends) - 1) if len(ends) > 1 else None
    seconds = time.monotonic() - began
    if sick is not None:
        time.sleep(SICK_S)
    return {"node": node, "results": results, "kept": kept, "why": why, "sick": sick, "case_s": case_s, "seconds": seconds}


def write_files(folder: Path, files: Files) -> None:
    for name, contents in files:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(contents)


def run_command(job: dict[str, Any], scratch: Path, name: str) -> tuple[Files, bool]:
    """Runs the program with the job's words and this one, in the scratch folder: what it printed, as `stdout`, and the files of the folder
    of that name, if it made one; and whether it came to its end."""
    epochs = scratch / name / "metrics.jsonl"

    def saved() -> int:
        return epochs.stat().st_size if epochs.exists() else 0

    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as said:
        process = subprocess.Popen([*PROGRAM, *job["command"], name], cwd=scratch, stdout=out, stderr=said, preexec_fn=heeds_signals)
        began, before, is_stopped = time.monotonic(), saved(), False
        try:
            while process.poll() is None:
                time.sleep(POLL_S)
                now = saved()
                if now > before and not is_stopped and time.monotonic() - began > job["slice_s"]:
                    process.send_signal(signal.SIGINT)
                    is_stopped = True
                before = now
        finally:
            # Where the task is cancelled.
            process.terminate()
            process.wait()
        out.seek(0)
        said.seek(0)
        printed, words = out.read(), said.read().decode("utf-8", "replace")
    folder = files_of(scratch / name) if (scratch / name).is_dir() else []
    if is_stopped and process.returncode == 130:
        return folder, False
    try:
        found = json.loads(printed)
    except ValueError:
        raise Failed(f"it ended with {process.returncode}: {last_line(words)}") from None
    if "error" in found:
        raise Failed(found["error"])
    return [("stdout", printed), *folder], True


def heeds_signals() -> None:
    """A command stops when it is asked to, which Ray keeps from its workers, and when its task is killed (Linux)."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
    if sys.platform == "linux":
        PR_SET_PDEATHSIG = 1
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


# Beside the campaign.


class Cluster:
    """What there is of nodes, looked at in a thread of its own: a head that is gone does not answer."""

    def __init__(self, job: dict[str, Any], tell: Any) -> None:
        self.job, self.tell = job, tell
        self.told: tuple[int, ...] = ()
        self.answered = time.monotonic()
        self.silent = False
        self.look()
        threading.Thread(target=self.watch, daemon=True).start()

    def look(self) -> None:
        """How many cases can be done at a time, on how many nodes."""
        nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        each = [node for node in (self.at_a_time(resources) for resources in nodes) if node > 0]
        cpus = int(sum(resources.get("CPU", 0) for resources in nodes))
        self.slots = sum(each)
        if (len(nodes), cpus, self.slots) != self.told:
            self.told = (len(nodes), cpus, self.slots)
            self.tell("cluster", nodes=len(nodes), cpus=cpus, slots=self.slots)
        self.largest = max(
            ((int(r.get("CPU", 0)), int(r.get("memory", 0))) for r in nodes if r.get("CPU")), default=(0, 0)
        )

    def at_a_time(self, resources: dict[str, float]) -> int:
        by_threads = resources.get("CPU", 0) // self.job["threads"]
        return int(min(by_threads, resources.get("memory", 0) // self.job["memory_bytes"]))

    def watch(self) -> None:
        def ask() -> None:
            while True:
                time.sleep(LOOK_S)
                self.look()
                self.answered = time.monotonic()

        threading.Thread(target=ask, daemon=True).start()
        while True:
            time.sleep(1.0)
            silent = time.monotonic() - self.answered > LOOK_S + SILENT_S
            if silent != self.silent:
                self.silent = silent
                self.tell("silent" if silent else "heard")

    def refusal(self) -> str:
        threads, memory = self.job["threads"], self.job["memory_bytes"]
        cpus, bytes_ = self.largest
        return (
            f"no node of the cluster has {count(threads, 'CPU')} and {memory / 2**20:.0f} MiB of memory for a {self.job['noun']}; the "
            f"largest has {count(cpus, 'CPU')} and {bytes_ / 2**20:.0f} MiB"
        )


class Work:
    """Cases that are left, in tasks of a few seconds each."""

    def __init__(
        self, job: dict[str, Any], cases: Iterable[Case], begun: dict[int, Files], tell: Any, stopped: threading.Event
    ) -> None:
        self.tell, self.stopped, self.job = tell, stopped, job
        # From what to go on.
        self.begun = begun
        self.left = deque(cases)
        self.tries: dict[int, int] = {}
        # What a case takes, how long tasks are to be, and how many cases of one have been tried.
        self.case_s: float | None = None
        self.task_s, self.reach = TASK_S, 1
        self.flying: dict[Any, list[Case]] = {}
        self.cluster = Cluster(job, tell)
        # How often a case is begun again is counted here, where it can be said.
        options = {"num_cpus": job["threads"], "memory": job["memory_bytes"], "max_retries": 0}
        self.remote = ray.remote(perform).options(**options)
        self.shared = ray.put(job)

    def batch(self) -> list[Case]:
        """Cases of the next task: as many as take a few seconds, fewer towards the end, and one that was lost by itself."""
        share = len(self.left) // (2 * max(self.cluster.slots, 1))
        by_time = MAX_BATCH if self.case_s is None else int(self.task_s / max(self.case_s, 1e-6))
        count = max(1, min(by_time, share, self.reach, MAX_BATCH))
        cases = [self.left.popleft()]
        while len(cases) < count and self.left and not (self.tries.get(cases[0][0]) or self.tries.get(self.left[0][0])):
            cases.append(self.left.popleft())
        return cases

    def work(self) -> None:
        while (self.left or self.flying) and not self.stopped.is_set():
            most = min(max(2 * self.cluster.slots, 2), MAX_TASKS)
            while self.left and len(self.flying) < most:
                cases = self.batch()
                begun = {index: self.begun[index] for index, _ in cases if index in self.begun}
                self.flying[self.remote.remote(self.shared, cases, begun)] = cases
            refs = list(self.flying)
            ready, rest = ray.wait(refs, timeout=0.5)
            if ready and rest:
                ready += ray.wait(rest, num_returns=len(rest), timeout=0)[0]
            for ref in ready:
                if not self.stopped.is_set():
                    self.ended(ref, self.flying.pop(ref))

    def ended(self, ref: Any, cases: list[Case]) -> None:
        """What a task has come to; what it has not done is done again."""
        try:
            found = ray.get(ref)
        except ray.exceptions.RayTaskError as error:
            raise self.unfit(error) from None
        except ray.exceptions.RuntimeEnvSetupError as error:
            raise Unfit(f"the cluster cannot prepare its nodes: {first_line(error)}") from None
        except ray.exceptions.RayError as error:
            self.lost(cases, first_line(error))
            return
        done = [index for index, _ in found["results"]]
        self.learn(len(done), found["case_s"], found["seconds"])
        for index, files in found["results"]:
            self.tell("done", index=index, files=files, node=found["node"])
        for index, files in found["kept"]:
            self.begun[index] = files
            self.tell("kept", index=index, files=files, node=found["node"])
        parted = [case for case in cases if case[0] in dict(found["kept"])]
        undone = [case for case in cases if case[0] not in done and case not in parted]
        if undone and found["why"] is not None:
            self.tell("failed", index=undone[0][0], why=f"on {found['node']}: {found['why']}")
            undone = undone[1:]
        if undone and found["sick"] is not None:
            self.lost(undone, found["sick"])
            undone = []
        self.left.extendleft(reversed(undone))
        # The others have their turn meanwhile.
        self.left.extend(parted)

    def learn(self, count: int, case_s: float | None, seconds: float) -> None:
        """How long tasks take, from one that did so many cases."""
        if case_s is not None:
            self.case_s = case_s if self.case_s is None else 0.7 * self.case_s + 0.3 * case_s
            self.task_s = min(max(TASK_S, BEGINS * (seconds - count * case_s)), LONGEST_S)
        if seconds < LONGEST_S:
            self.reach = max(self.reach, 2 * count)

    def lost(self, cases: list[Case], why: str) -> None:
        again = []
        for case in cases:
            tries = self.tries[case[0]] = self.tries.get(case[0], 0) + 1
            if tries < MAX_TRIES:
                again.append(case)
            else:
                self.tell("failed", index=case[0], why=f"it was begun {tries} times, and lost each time, at last so: {why}")
        self.left.extendleft(reversed(again))
        if again:
            self.tell("again", count=len(again), why=why)

    def unfit(self, error: Any) -> Unfit:
        """What keeps a node from doing anything."""
        if isinstance(error.cause, Unfit):
            return error.cause
        return Unfit(
            f"a node of the cluster can do no {self.job['noun']}: {first_line(error.cause)}; each must have this version of powderline "
            "(pip install), or get it by runtime_env"
        )


def last_line(text: str) -> str:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "it said nothing"


def first_line(error: BaseException | str) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0].rstrip(".") if lines else type(error).__name__


def main() -> None:
    """Does what is asked for on standard input, until that ends."""
    out: BinaryIO = os.fdopen(os.dup(1), "wb")
    # What Ray or others print is no message.
    os.dup2(2, 1)
    whole = threading.Lock()

    def tell(kind: str, **what: Any) -> None:
        with whole:
            pickle.dump((kind, what), out)
            out.flush()

    job = pickle.load(sys.stdin.buffer)
    stopped = threading.Event()

    def listen() -> None:
        sys.stdin.buffer.read()
        stopped.set()
        # Whatever Ray is still about.
        time.sleep(10.0)
        os._exit(1)

    threading.Thread(target=listen, daemon=True).start()
    try:
        connect(job)
        work = Work(job["of_task"], job["cases"], job["begun"], tell, stopped)
        if work.cluster.slots == 0 and not job["wait"]:
            tell("refused", why=work.cluster.refusal())
            return
        work.work()
        for ref in work.flying:
            ray.cancel(ref)
        if work.flying:
            # They stop their processes, and clear away what these have written.
            ray.wait(list(work.flying), num_returns=len(work.flying), timeout=3.0)
        tell("stopped" if stopped.is_set() else "finished")
    except Unfit as error:
        tell("refused", why=str(error))
    except Exception as error:  # Ray raises whatever it likes.
        tell("broken", why=f"{where(job['address'])} cannot be used: {first_line(error)}")


def connect(job: dict[str, Any]) -> None:
    """To a cluster, or to one that is begun here and ends with this process."""
    address = job["address"] or os.environ.get("RAY_ADDRESS") or "local"
    host = re.fullmatch(r"(?:ray://)?([^/]+):(\d+)", address)
    if host is not None:
        # Ray itself would look for minutes.
        try:
            socket.create_connection((host[1], int(host[2])), CONNECT_S).close()
        except OSError as error:
            raise Unfit(f"at {address} there is no Ray cluster that answers ({error}); `ray start --head` begins one") from None
    usual: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR", "runtime_env": job["runtime_env"]}
    if address == "local":
        usual["include_dashboard"] = False
    ray.init(address, **usual)


if __name__ == "__main__":
    # Under its own name, so that nodes find what they are to do in the package.
    from powderline import _tasks

    _tasks.main()
