"""PyTorch and Gymnasium."""

import numpy as np
import pytest

import powderline as pl

THETA = [0.3, 0.0, 0.0, 0.0, 0.3]


def test_torch_goes_back_through_a_rollout(scene):
    torch = pytest.importorskip("torch")
    from powderline.torch import loss

    simulator = pl.Simulator(scene)
    theta = torch.tensor([THETA, [0.5, 0.0, 0.0, 0.0, 0.3]], dtype=torch.float64, requires_grad=True)
    losses = loss(simulator, theta)
    assert losses.shape == (2,)
    (3.0 * losses[0] - losses[1]).backward()
    found, gradient = simulator.gradient(THETA)
    assert losses[0].item() == found.loss
    np.testing.assert_array_equal(theta.grad[0].numpy(), 3.0 * gradient)
    _, other = simulator.gradient(theta.detach()[1].numpy())
    np.testing.assert_array_equal(theta.grad[1].numpy(), -other)


def test_torch_computes_what_is_asked_for_and_nothing_else(scene):
    torch = pytest.importorskip("torch")
    from powderline.torch import loss

    simulator = pl.Simulator(scene)

    class WithoutGradient:
        rollouts = staticmethod(simulator.rollouts)

    theta = torch.tensor(THETA, dtype=torch.float64, requires_grad=True)
    found = simulator.rollout(THETA).loss
    with torch.no_grad():
        assert loss(WithoutGradient(), theta).item() == found
    assert loss(WithoutGradient(), theta.detach()).item() == found
    with pytest.raises(AttributeError, match="gradient"):
        loss(WithoutGradient(), theta)
    with pytest.raises(TypeError, match="torch.int64, but it must be of floating-point numbers"):
        loss(simulator, torch.tensor([0, 0, 0, 0, 0]))
    with pytest.raises(ValueError, match=r"shape \(10,\), but it must be \(5,\) or \(n, 5\)"):
        loss(simulator, torch.zeros(10))


@pytest.mark.parametrize("name", ["powderline/Skill-v0", "powderline/Motion-v0"])
def test_gymnasium_approves_of_the_environments(name, scene):
    gymnasium = pytest.importorskip("gymnasium")
    import warnings

    from gymnasium.utils.env_checker import check_env

    import powderline.gym  # noqa: F401

    env = gymnasium.make(name, scene=scene)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # The observation is a constant, or has no bounds, on purpose; the checker says so in a warning.
        warnings.filterwarnings("ignore", message=".*(infinity|different from|render).*")
        check_env(env.unwrapped, skip_render_check=True)


def test_the_stepwise_environment_scoops_when_told_to(scene):
    pytest.importorskip("gymnasium")
    from powderline.gym import MotionEnv

    env = MotionEnv(scene)
    first, _ = env.reset()
    assert first["heights_m"].shape == (22, 8)
    assert first["heights_m"].max() == pytest.approx(0.018, abs=0.004)
    assert first["tool"].tolist() == [0.0] * 6
    total, length, rows = 0.0, 0, []
    make = env._displacements
    env._displacements = lambda wanted: (rows.append(make(wanted)[0]), make(wanted))[1]
    while True:
        seen, reward, terminated, truncated, info = env.step(np.array([0.0, -0.3, 0.0], np.float32))
        assert env.observation_space.contains(seen)
        total, length = total + reward, length + 1
        if terminated or truncated:
            break
    assert length == 66 and terminated and not truncated
    # Down to the workspace's end, and no powder in the target.
    assert seen["tool"][1] == pytest.approx(0.016 - 0.047, abs=0.003)
    assert total <= 0.0 and info["mass_kg"] == 0.0
    # The rewards add up to what is lost, over what is wanted, and the tool has pressed the powder aside.
    wanted_kg = scene.to_dict()["objective"]["amount"]["mass_kg"]
    assert total == pytest.approx(-info["lost_kg"] / wanted_kg, abs=1e-12)
    assert np.abs(seen["heights_m"] - first["heights_m"]).max() > 0.003
    # Braked before the border, as hard as the limits allow.
    limits, motion = scene.to_dict()["limits"], np.concatenate(rows)
    height = scene.start_pose[2] + np.cumsum(motion[:, 2])
    assert limits["workspace_min_m"][2] - 1e-12 <= height.min() < limits["workspace_min_m"][2] + 1e-4
    change = np.abs(np.diff(motion[:, 2], prepend=0.0)) / scene.control_period_s**2
    most = limits["linear_acceleration_m_s2"] / np.sqrt(2.0)
    assert 0.9 * most < change.max() <= most * (1.0 + 1e-9)


def test_motions_that_come_to_no_end_end_an_episode(scene):
    pytest.importorskip("gymnasium")
    from powderline.gym import MotionEnv, SkillEnv

    class Escapes:
        initial_loss = 3.0
        positions_m = np.zeros((1, 3), np.float32)

        def rollout(self, theta):
            raise pl.MotionError("powder left")

        step = rollout

    env = SkillEnv(scene)
    assert env.simulator.initial_loss > env.simulator.rollout(THETA).loss
    env.simulator = Escapes()
    env.reset()
    assert env.step(np.zeros(5, np.float32))[1:] == (-6.0, True, False, {"error": "powder left"})
    env = MotionEnv(scene)
    env.reset()
    _, worth, *_ = env.step(np.zeros(3, np.float32))
    env._episode = Escapes()
    assert env.step(np.ones(3, np.float32))[1:] == (-1.0 - max(worth, 0.0), True, False, {"error": "powder left"})
    assert not env._velocity.any()
