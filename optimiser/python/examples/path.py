"""A path beside the skill that it is near: how the tool goes, and what each brings.

    optimise run bench --method path --no-refine --out run
    python path.py run/skill.plan path.png        # needs matplotlib

Solid the path, dashed its skill; dotted the arm's limit.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import powderline as pl


def pitch_deg(poses):
    """How far the tool is pitched forward since the start, degrees, from its quaternions (w, x, y, z)."""
    half = np.unwrap(2 * np.arctan2(poses[:, 5], poses[:, 3])) / 2
    return np.degrees(2 * (half - half[0]))


def jerks(plan):
    """Root mean square of the tool's jerk over the whole motion, m/s^3, and of its angular jerk, rad/s^3."""
    jerk = np.diff(plan.displacements, 2, axis=0) / plan.control_period_s**3
    return [np.sqrt(np.mean(np.sum(part**2, axis=1))) for part in (jerk[:, :3], jerk[:, 3:])]


def words(name, plan):
    return f"{name}: {1e3 * plan.mass_kg:.3f} g ({100 * plan.miss:+.2g} %), {1e6 * plan.lost_kg:.0f} mg lost, loss {plan.loss:.2f} m"


def main(plan, picture):
    path = pl.Plan.load(plan)
    if path.path_coefficients == 0:
        sys.exit(f"{plan} is a skill's own motion: a plan of `optimise run --method path` would be right")
    scene = path.scene
    if scene is None:
        sys.exit(f"{plan} lies beside no scene.toml: the folder of a run would be right")
    skill = pl.Simulator(scene, seed=path.seed).plan(path.theta)
    figure, (side, turn, speed) = plt.subplots(1, 3, figsize=(12, 3.6))
    for name, motion, style in (("path", path, "-"), ("its skill", skill, "--")):
        print(words(name, motion))
        print("  jerk, root mean square: {:.2f} m/s^3, {:.2f} rad/s^3".format(*jerks(motion)))
        times, poses = motion.times_s, motion.poses
        heading = np.radians(scene.to_dict()["skill"]["heading_deg"])
        ahead = poses[:, :2] @ [np.cos(heading), np.sin(heading)]
        side.plot(1e3 * ahead, 1e3 * poses[:, 2], style, label=name)
        turn.plot(times, pitch_deg(poses), style)
        velocity = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1) / motion.control_period_s
        speed.plot(times[1:], velocity, style)
    speed.axhline(scene.to_dict()["limits"]["linear_velocity_m_s"], linestyle=":", color="black")
    side.set(xlabel="along the heading, mm", ylabel="z, mm", aspect="equal")
    turn.set(xlabel="time, s", ylabel="pitch since the start, degrees")
    speed.set(xlabel="time, s", ylabel="speed of the tool, m/s")
    side.legend(fontsize=8)
    figure.suptitle(f"{words('path', path)}\n{words('its skill', skill)}", fontsize=9)
    figure.tight_layout()
    figure.savefig(picture, dpi=120)


if __name__ == "__main__":
    main(*sys.argv[1:])
