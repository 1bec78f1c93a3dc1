"""What Python costs: a rollout, a gradient and 1,000 frames, here and by the Rust example `overhead`, in instructions, which do not
depend on what else the machine does.

    cargo build --release -p powderline-simulator --example overhead
    python optimiser/python/examples/overhead.py target/release/examples/overhead

Valgrind counts them; what a process takes that does nothing of it is taken off. Prints the ratio for each kind of work, of `bench-small`
on a grid twice as coarse: there a rollout is sixteen times shorter, and Python's share so much the larger.
"""

import re
import subprocess
import sys

import numpy as np

import powderline as pl

THETA = [0.3, 0.0, 0.0, 0.0, 0.3]


def do(work: str) -> None:
    """One kind of work, the powder having settled before."""
    scene = pl.Scene.load("bench-small").replace(domain={"cell_m": 0.008}, time={"substeps": 10})
    simulator = pl.Simulator(scene, threads=1)
    simulator.rollouts(np.empty((0, 5)))
    if work == "rollout":
        simulator.rollout(THETA)
    elif work == "gradient":
        simulator.gradient(THETA, kind="restarted")
    elif work == "frames":
        simulator.motion(np.zeros((1000, 6)), every=1)


def instructions(command: list[str]) -> int:
    """How many a process takes."""
    counter = ["valgrind", "--tool=cachegrind", "--cache-sim=no", "--cachegrind-out-file=/dev/null"]
    said = subprocess.run([*counter, *command], check=True, capture_output=True, text=True).stderr
    found = re.search(r"I\s+refs:\s+([\d,]+)", said)
    assert found is not None, said
    return int(found[1].replace(",", ""))


def main() -> None:
    if sys.argv[1] == "--do":
        return do(sys.argv[2])
    works = ["nothing", "rollout", "gradient", "frames"]
    here, there = ({work: instructions([*program, work]) for work in works}
                   for program in ([sys.executable, __file__, "--do"], [sys.argv[1]]))
    for work in works[1:]:
        ours, theirs = here[work] - here["nothing"], there[work] - there["nothing"]
        print(f"{work:8s} {ours / theirs:.4f} times the instructions of Rust, {ours / 1e9:.2f} thousand million")


if __name__ == "__main__":
    main()
