"""What Python costs: rollouts, gradients and frames, here and by the Rust example `overhead`, one after the other in one run.

    cargo build --release -p powderline-simulator --example overhead
    python optimiser/python/examples/overhead.py target/release/examples/overhead [ROUNDS]

Prints, for each kind of work, the median of the ratios of both processor times.
"""

import json
import statistics
import subprocess
import sys
import time

import numpy as np

import powderline as pl

THETA = [0.3, 0.0, 0.0, 0.0, 0.3]


def here() -> dict[str, float]:
    """Processor seconds of each kind of work, the powder having settled before."""
    scene = pl.Scene.load("bench-small")
    simulator = pl.Simulator(scene, threads=1)
    # As long as 1,000 frames.
    rest = np.zeros((1000, 6))
    simulator.rollouts(np.empty((0, 5)))
    seconds = {}
    for name, work in {
        "rollout": lambda: simulator.rollout(THETA),
        "gradient": lambda: simulator.gradient(THETA, kind="restarted"),
        "frames": lambda: simulator.motion(rest, every=1),
    }.items():
        began = time.process_time()
        work()
        seconds[name] = time.process_time() - began
    return seconds


def main() -> None:
    program, rounds = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 5
    ratios: dict[str, list[float]] = {}
    for _ in range(rounds):
        there = json.loads(subprocess.run([program], check=True, capture_output=True, text=True).stdout)
        for name, seconds in here().items():
            ratios.setdefault(name, []).append(seconds / there[name])
    for name, all_of in ratios.items():
        print(f"{name:8s} {statistics.median(all_of):.3f} (from {min(all_of):.3f} to {max(all_of):.3f}) times as long as in Rust")


if __name__ == "__main__":
    main()
