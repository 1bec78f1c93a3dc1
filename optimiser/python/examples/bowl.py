"""A loaded bowl, cut open: how powder lies in it, by what the walls are and how small the cells are.

    python bowl.py bowl.png        # some five minutes; needs matplotlib

One skill of `bench`, looked at when the tool is highest: the slice of 2 mm about its middle, in the tool's frame.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import powderline as pl

SKILL = [0.3, 0.0, 0.0, 0.0, 0.3]
#: Half the slice, metres.
HALF_M = 0.001
#: What is so near to the wall is counted as lying at it, metres.
NEAR_M = 0.001


#: How powder sleeps beside walls with two sides, and beside shared ones, as of a scene that does not say.
SLEEP = {
    "two_sided": {},
    "shared": {"sleep_by": "largest", "sleepers": "moving", "sleep_speed_m_s": 0.002},
}


def scene(walls, parts):
    """`bench` with these walls, its cells divided by so much."""
    bench = pl.Scene.load("bench")
    substeps = parts * bench.to_dict()["time"]["substeps"]
    return bench.replace(domain={"walls": walls, "cell_m": bench.cell_m / parts, **SLEEP[walls]}, time={"substeps": substeps})


def rotation(quaternion):
    """From the tool's frame to the world's."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def held(scene):
    """Particles in and above the bowl when it is highest, in its frame, (particles, 3), and what the skill brings."""
    motion = pl.Simulator(scene).motion(scene.displacements(SKILL))
    tool = motion.tool
    highest = int(np.argmax(tool[:, 2] >= tool[:, 2].max() - 1e-4))
    points = (motion.positions_m[highest] - tool[highest, :3]) @ rotation(tool[highest, 3:7])
    radius = scene.to_dict()["tool"]["shape"]["inner_radius_m"]
    is_held = (np.hypot(points[:, 0], points[:, 1]) < 1.25 * radius) & (np.abs(points[:, 2] + 0.25 * radius) < 1.1 * radius)
    return points[is_held], radius, motion.evaluation


def main(path):
    figure, axes = plt.subplots(2, 2, figsize=(9, 6.4), sharex=True, sharey=True)
    angles = np.linspace(np.pi, 2 * np.pi, 100)
    for row, parts in zip(axes, (1, 2)):
        for axis, walls in zip(row, ("shared", "two_sided")):
            bench = scene(walls, parts)
            points, radius, found = held(bench)
            at_wall = (np.linalg.norm(points, axis=1) > radius - NEAR_M) & (points[:, 2] < 0)
            grams = 1e3 * bench.particle_mass_kg
            words = f"{walls}, {1e3 * bench.cell_m:g} mm: {len(points) * grams:.2f} g held, {at_wall.sum() * grams:.2f} g at the wall"
            print(f"{words}; brings {1e3 * found.mass_kg:.3f} g", flush=True)
            cut = 1e3 * points[np.abs(points[:, 1]) < HALF_M]
            for edge in (1e3 * radius, 1e3 * radius + 4):
                axis.plot(edge * np.cos(angles), edge * np.sin(angles), color="black", linewidth=1)
            axis.plot(cut[:, 0], cut[:, 2], ".", markersize=4 / parts, color="#b8741a")
            axis.set_title(words, fontsize=8)
            axis.set_aspect("equal")
    figure.supxlabel("x of the tool, mm")
    figure.supylabel("z of the tool, mm")
    figure.tight_layout()
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main(*sys.argv[1:])
