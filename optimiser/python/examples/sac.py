"""Stable-Baselines3's soft actor-critic on `powderline/Skill-v0`: an outside check of the one that `optimise compare` has.

    python optimiser/python/examples/sac.py [SCENE [ROLLOUTS [SEED,..]]]

Settings as there: batch 8, learning rates 0.001, discount 0.99, eight uniform actions first, one gradient step an episode. The
same is made by `optimise compare SCENE --methods sac --rollouts 121`.
"""

import sys

from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from powderline.gym import SkillEnv


class Losses(BaseCallback):
    """The losses of all episodes; of a skill that comes to no end there is none."""

    def __init__(self) -> None:
        super().__init__()
        self.losses: list[float] = []

    def _on_step(self) -> bool:
        self.losses += [info.get("loss", float("inf")) for info in self.locals["infos"]]
        return True


def main() -> None:
    scene, rollouts, seeds = (sys.argv[1:] + ["bench-small", "121", "1,2,3"][len(sys.argv) - 1 :])[:3]
    print(f"{scene}: lowest loss after .. rollouts, m")
    at = sorted({count for count in (11, 30, 66) if count < int(rollouts)} | {int(rollouts)})
    print("seed" + "".join(f"{count:8d}" for count in at))
    for seed in map(int, seeds.split(",")):
        env = VecNormalize(DummyVecEnv([lambda: SkillEnv(scene, seed=seed)]), norm_obs=False, gamma=0.99)
        agent = SAC("MlpPolicy", env, seed=seed, batch_size=8, learning_rate=1e-3, gamma=0.99, learning_starts=8)
        watch = Losses()
        agent.learn(int(rollouts), callback=watch)
        print(f"{seed:4d}" + "".join(f"{min(watch.losses[:count]):8.3f}" for count in at), flush=True)


if __name__ == "__main__":
    main()
