"""Powder that a robot scoops and pours: a differentiable simulator, and the search for the motion.

    import powderline as pl

    scene = pl.Scene.load("bench-small")            # one of Scene.names(), or a TOML file
    simulator = pl.Simulator(scene)
    theta = [0.3, 0.0, 0.0, 0.0, 0.3]               # depth, scooping angle, lift, transport, pouring angle, -1 to 1

    found = simulator.rollout(theta)                # Evaluation(1.208 g of 1.6 g (-24 %), 0 mg lost, loss 4.338 m)
    found, gradient = simulator.gradient(theta)     # and its gradient, an array of shape (5,)
    motion = simulator.motion(scene.displacements(theta), every=10)
    motion.positions_m                              # every particle on its way: (frames, particles, 3)

    run = pl.optimise(scene)                        # the search; its folder is what the program `optimise` writes
    run.met                                         # whether its plan brings what is wanted; run.summary says what could help
    run.plan.save("skill.plan")                     # what the repository's program `execute` plays to an arm
    run.plan.to_joint_angles()                      # radians, (steps + 1, 6)
    pl.report(run)                                  # a page with curves and a replay in 3-D, which a notebook shows

Units are SI and stand in the names. World frame: z up, the floor at z = 0. Poses are x, y, z in metres and a unit quaternion
w, x, y, z. The same scene, seed and precision give the same bits on any machine, for any number of threads.

What is here: `Scene`, `Simulator` with `Evaluation`, `Motion` and `Episode`, `Plan`, `optimise` and `Run`, `report` and `Report`; the
exceptions `SceneError`, `SkillError` and `PlanError` (each a ValueError), `SimulationError` and its `MotionError`; `SKILL_PARAMETERS`, what the
components of theta are called.

`powderline.torch` differentiates a rollout within PyTorch, `powderline.gym` has environments for reinforcement learning. The program
`optimise` comes along; `python -m powderline` is the same.
"""

from ._native import (
    Episode,
    Evaluation,
    Motion,
    MotionError,
    Plan,
    PlanError,
    Scene,
    SceneError,
    SimulationError,
    Simulator,
    SkillError,
    __version__,
)
from ._run import Report, Run, optimise, report

#: Names of the components of theta, in their order.
SKILL_PARAMETERS: tuple[str, ...] = (
    "scooping depth",
    "scooping angle",
    "lift height",
    "transport displacement",
    "pouring angle",
)

__all__ = [
    "SKILL_PARAMETERS",
    "Episode",
    "Evaluation",
    "Motion",
    "MotionError",
    "Plan",
    "PlanError",
    "Report",
    "Run",
    "Scene",
    "SceneError",
    "SimulationError",
    "Simulator",
    "SkillError",
    "__version__",
    "optimise",
    "report",
]
