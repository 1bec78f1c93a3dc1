"""Environments for reinforcement learning, as Gymnasium has them.

    import gymnasium, powderline.gym
    env = gymnasium.make("powderline/Skill-v0", scene="bench-small")

`powderline/Skill-v0` is one skill an episode; `powderline/Motion-v0` moves the tool every 50 ms, and sees the powder from above.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from ._native import Episode, Evaluation, MotionError, Scene, Simulator

_F32 = npt.NDArray[np.float32]


def _scene(scene: Scene | str) -> Scene:
    return Scene.load(scene) if isinstance(scene, str) else scene


def _info(found: Evaluation) -> dict[str, Any]:
    return {"loss": found.loss, "mass_kg": found.mass_kg, "miss": found.miss, "lost_kg": found.lost_kg}


def _action(action: _F32, numbers: int) -> npt.NDArray[np.float64]:
    """Within the action space; what has another shape would be spread over all numbers."""
    if np.shape(action) != (numbers,):
        raise ValueError(f"the action has shape {np.shape(action)}, but it must be ({numbers},)")
    return np.clip(np.asarray(action, np.float64), -1.0, 1.0)


def _reach(scene: Scene, limits: dict[str, Any], forward: npt.NDArray[np.float64]) -> list[npt.NDArray[np.float64]]:
    """Least and most travel along heading, up and in pitch that keep the tool within the workspace, and within what is simulated."""
    start = scene.start_pose[:3]
    # Less what sums are rounded by.
    low = np.maximum(limits["workspace_min_m"], 1e-6) - start
    high = np.minimum(limits["workspace_max_m"], scene.size_m - 1e-6) - start
    along = [(low[k] / forward[k], high[k] / forward[k]) for k in (0, 1) if abs(forward[k]) > 1e-9]
    least, most = max(min(pair) for pair in along), min(max(pair) for pair in along)
    return [np.array([least, low[2], -np.inf]), np.array([most, high[2], np.inf])]


class SkillEnv(gymnasium.Env[_F32, _F32]):
    """One skill an episode: the action is theta, shape (5,); the reward is the negated loss, metres; there is nothing to observe but a
    constant. The problem that Wei et al. 2025 give to soft actor-critic. A skill that comes to no end (`MotionError`) costs twice what
    lying still does, and `info` has `error` alone.

    Args:
        scene: a `Scene`, a name or a file.
        seed: of the packing; the scene's if None. It stays the same from episode to episode, so that a skill's reward does.
        threads: of the simulator.
        precision: "f32" or "f64".
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(
        self, scene: Scene | str = "bench", *, seed: int | None = None, threads: int | None = None, precision: Any = "f32"
    ) -> None:
        self.simulator = Simulator(_scene(scene), seed=seed, threads=threads, precision=precision)
        self.observation_space = spaces.Box(0.0, 1.0, (1,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (5,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[_F32, dict[str, Any]]:
        """The bench as it was; `seed` changes nothing, for nothing here is drawn."""
        super().reset(seed=seed)
        return np.ones(1, np.float32), {}

    def step(self, action: _F32) -> tuple[_F32, float, bool, bool, dict[str, Any]]:
        """Performs the skill. `info` has `loss` (m), `mass_kg`, `miss`, `lost_kg`."""
        theta = _action(action, 5)
        try:
            found = self.simulator.rollout(theta)
        except MotionError as error:
            return np.ones(1, np.float32), -2.0 * self.simulator.initial_loss, True, False, {"error": str(error)}
        return np.ones(1, np.float32), -found.loss, True, False, _info(found)


class MotionEnv(gymnasium.Env[dict[str, Any], _F32]):
    """Moves the tool every 50 ms.

    Action: shape (3,), each from -1 to 1: along the heading, up, and pitching forward, in units of what the scene's limits allow at
    constant speed. The motion accelerates and brakes no faster than the limits allow either, and comes to rest at the workspace's
    border; what is left of an action then is less.

    interval_s: how long an action takes, seconds; at most as long as the scene's horizon.

    Observation: `heights_m`, how high the powder is above each grid cell of the scene, metres, shape (cells along x, along y); `tool`,
    how far the tool is from its start along heading and up (m), and pitched (rad), with its velocities (m/s, rad/s), shape (6,); `time`,
    the share of the episode that is over, shape (1,).

    Reward: what is nearer to the wanted mass in the target container than at the last step, less what more is lost, in units of the
    wanted mass: over an episode it adds up to 1 at most. An episode ends with the scene's horizon (terminated: `time` is observed). One
    that comes to no end before (`MotionError`) ends there, with a sum of -1 at most, and `info` has `error` alone.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(
        self,
        scene: Scene | str = "bench",
        *,
        seed: int | None = None,
        threads: int | None = None,
        precision: Any = "f32",
        interval_s: float = 0.05,
    ) -> None:
        self.scene = _scene(scene)
        self.simulator = Simulator(self.scene, seed=seed, threads=threads, precision=precision)
        fields = self.scene.to_dict()
        self._period_s = self.scene.control_period_s
        horizon = int(fields["time"]["horizon_steps"])
        if not 0.0 < interval_s <= horizon * self._period_s * (1.0 + 1e-9):
            raise ValueError(f"interval_s is {interval_s}, but it must be seconds, more than 0 and at most {horizon * self._period_s:g}")
        self._steps = min(max(1, round(interval_s / self._period_s)), horizon)
        self._horizon = horizon // self._steps
        limits, skill = fields["limits"], fields["skill"]
        self._speed = np.array([limits["linear_velocity_m_s"], limits["linear_velocity_m_s"], limits["angular_velocity_rad_s"]])
        # A diagonal of both translations keeps the limit, too.
        self._speed[:2] /= np.sqrt(2.0)
        self._gain = self._period_s * np.array(
            [limits["linear_acceleration_m_s2"], limits["linear_acceleration_m_s2"], limits["angular_acceleration_rad_s2"]]
        )
        self._gain[:2] /= np.sqrt(2.0)
        heading = np.radians(skill["heading_deg"])
        self._forward = np.array([np.cos(heading), np.sin(heading), 0.0])
        self._reach = _reach(self.scene, limits, self._forward)
        self._pitch_axis = np.array([-np.sin(heading), np.cos(heading), 0.0])
        self._cells = np.ceil(self.scene.size_m[:2] / self.scene.cell_m - 1e-9).astype(int)
        self.action_space = spaces.Box(-1.0, 1.0, (3,), np.float32)
        top = np.float32(self.scene.size_m[2])
        self.observation_space = spaces.Dict(
            {
                "heights_m": spaces.Box(0.0, top, tuple(int(n) for n in self._cells), np.float32),
                "tool": spaces.Box(-np.inf, np.inf, (6,), np.float32),
                "time": spaces.Box(0.0, 1.0, (1,), np.float32),
            }
        )
        self._episode: Episode | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """The settled bench; `seed` changes nothing, for nothing here is drawn."""
        super().reset(seed=seed)
        self._episode = self.simulator.episode()
        self._count = 0
        self._velocity, self._travel = np.zeros(3), np.zeros(3)
        self._worth = 0.0
        return self._observation(), {}

    def step(self, action: _F32) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Moves the tool for one interval. `info` has `loss` (m), `mass_kg`, `miss`, `lost_kg`."""
        if self._episode is None:
            raise RuntimeError("the environment has not been reset yet")
        wanted = _action(action, 3) * self._speed
        rows, velocity, travel = self._displacements(wanted)
        try:
            found = self._episode.step(rows)
        except MotionError as error:
            return self._observation(), -1.0 - max(self._worth, 0.0), True, False, {"error": str(error)}
        self._velocity, self._travel = velocity, travel
        self._count += 1
        short = min(1.0, abs(found.miss))
        worth = 1.0 - short - found.lost_kg / found.wanted_kg
        reward, self._worth = worth - self._worth, worth
        return self._observation(), float(reward), self._count >= self._horizon, False, _info(found)

    def _displacements(self, wanted: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], ...]:
        """From the present velocity towards the wanted one, within the workspace; shape (control steps, 6). And the velocity and how far
        the tool is then."""
        rows = np.zeros((self._steps, 6))
        velocity, travel = self._velocity, self._travel
        for row in rows:
            aim = np.clip(wanted, -self._fastest(travel - self._reach[0]), self._fastest(self._reach[1] - travel))
            velocity = velocity + np.clip(aim - velocity, -self._gain, self._gain)
            moved = velocity * self._period_s
            travel = travel + moved
            row[:3] = moved[0] * self._forward + np.array([0.0, 0.0, moved[1]])
            row[3:] = moved[2] * self._pitch_axis
        return rows, velocity, travel

    def _fastest(self, room: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """How fast the tool may be with so much room before it: as fast as it can be braked in it, in steps of the period. Of n whole steps
        of the acceleration and a part f, braking takes (n + 1) (n / 2 + f) of the way that one such step goes in a period."""
        ways = np.clip(room / (self._gain * self._period_s), 0.0, 1e9)
        whole = np.floor(0.5 * (np.sqrt(1.0 + 8.0 * ways) - 1.0))
        return self._gain * (0.5 * whole + ways / (whole + 1.0))

    def _observation(self) -> dict[str, Any]:
        assert self._episode is not None
        positions = self._episode.positions_m
        cells = np.clip((positions[:, :2] / self.scene.cell_m).astype(int), 0, self._cells - 1)
        heights = np.zeros(tuple(self._cells), np.float32)
        np.maximum.at(heights, (cells[:, 0], cells[:, 1]), positions[:, 2])
        top = np.float32(self.scene.size_m[2])
        return {
            "heights_m": np.clip(heights, 0.0, top),
            "tool": np.concatenate([self._travel, self._velocity]).astype(np.float32),
            "time": np.array([self._count / self._horizon], np.float32),
        }


gymnasium.register("powderline/Skill-v0", entry_point="powderline.gym:SkillEnv")
gymnasium.register("powderline/Motion-v0", entry_point="powderline.gym:MotionEnv")
