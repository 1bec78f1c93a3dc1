"""The package as its users have it. What is simulated is tested in Rust; here, that it comes through."""

import copy
import gc
import html
import json
import os
import pickle
import re
import signal
import subprocess
import sys
import threading
import time
import weakref
from pathlib import Path

import numpy as np
import pytest

import powderline as pl

THETA = [0.3, 0.0, 0.0, 0.0, 0.3]


@pytest.fixture(scope="module")
def simulator(scene):
    return pl.Simulator(scene, threads=2)


@pytest.fixture(scope="module")
def found(simulator):
    return simulator.rollout(THETA)


def test_scenes_come_and_go_as_dictionaries_files_and_pickles(scene, tmp_path):
    assert "bench" in pl.Scene.names()
    assert "[powder]" in pl.Scene.text()
    assert pl.Scene.from_dict(scene.to_dict()) == scene
    file = tmp_path / "mine.toml"
    file.write_text(scene.to_toml())
    assert pl.Scene.from_toml(file.read_text()) == scene
    with pytest.raises(pl.SceneError, match="the text"):
        pl.Scene.from_toml("powder = 1")
    assert pl.Scene.load(str(file)).digest == pl.Scene.load(file).digest == scene.digest
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert scene.displacements(THETA).shape == (330, 6)
    assert scene.start_pose.shape == (7,)
    depth_m = scene.parameters([1.0, 0.0, 0.0, 0.0, 0.0])[0]
    assert depth_m == scene.to_dict()["skill"]["scooping_depth_m"][1]


def test_replace_changes_what_is_named_and_nothing_else(scene):
    changed = scene.replace(powder={"friction_angle_deg": 32.0}, container={"target": {"friction": 0.3}})
    before, after = scene.to_dict(), changed.to_dict()
    assert after["powder"].pop("friction_angle_deg") == 32.0
    assert before["powder"].pop("friction_angle_deg") == 35.0
    assert after["container"][1].pop("friction") == 0.3
    assert before["container"][1].pop("friction") == 0.4
    assert after == before
    cylinder = {"kind": "cylinder", "inner_radius_m": 0.018, "inner_height_m": 0.028}
    other = scene.replace(container={"target": {"shape": cylinder}})
    assert other.to_dict()["container"][1]["shape"] == cylinder


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"powder": {"density_kg_m3": -1.0}}, "powder.density_kg_m3 is -1, but it must be from 10 to 25000"),
        ({"powder": {"densty_kg_m3": 1.0}}, "unknown field `densty_kg_m3`; did you mean `density_kg_m3`? Possible are"),
        ({"container": {"goal": {"yaw_deg": 1.0}}}, "there is no container called goal; there are source, target"),
        ({"gate": {"lid": {"yaw_deg": 1.0}}}, "there is no gate called lid; there are none"),
        ({"powder": 3}, "powder"),
        ({"powder": {"density_kg_m3": float("nan")}}, "powder.density_kg_m3 is nan, but it must be from 10 to 25000"),
        ({"powder": {"density_kg_m3": 1e5}}, "powder.density_kg_m3 is 100000, but it must be from 10 to 25000"),
        ({"powder": {"density_kg_m3": object()}}, "powder.density_kg_m3 is a object, but it must be a number"),
    ],
)
def test_a_wrong_scene_is_a_sentence(scene, change, sentence):
    with pytest.raises(pl.SceneError) as error:
        scene.replace(**change)
    assert sentence in str(error.value)
    assert " line " not in str(error.value)
    assert isinstance(error.value, ValueError)


def test_numbers_of_numpy_are_numbers(scene):
    size = np.array(scene.to_dict()["domain"]["size_m"], np.float32).astype(np.float64)
    changed = scene.replace(powder={"density_kg_m3": np.float32(1200), "particles_per_cell": np.int64(8)}, domain={"size_m": size})
    assert changed.to_dict()["powder"]["density_kg_m3"] == 1200.0
    with pytest.raises(pl.SceneError) as error:
        scene.replace(powder={"density_kg_m3": 1e5})
    assert "metres" not in str(error.value)


def test_an_unknown_scene_is_a_sentence():
    with pytest.raises(pl.SceneError, match="bench"):
        pl.Scene.load("bensh")


def test_a_rollout_is_what_the_program_finds(scene, simulator, found, file):
    program = subprocess.run(
        [sys.executable, "-m", "powderline", "simulate", file, "--theta=0.3,0,0,0,0.3", "--json"],
        check=True, capture_output=True, text=True,
    )
    said = json.loads(program.stdout)
    assert said["loss_m"] == found.loss
    assert said["mass_kg"] == found.mass_kg
    assert said["census"] == found.census
    assert sum(found.census.values()) == scene.particles
    assert found.met is False and found.wanted_kg == scene.wanted_kg
    assert "wanted" not in repr(found) and "loss" in repr(found)


def test_a_packing_is_the_scenes_own_if_none_is_asked_for(scene, simulator, found):
    other = scene.replace(powder={"seed": 7})
    assert (simulator.seed, pl.Simulator(other).seed, pl.Simulator(other, seed=1).seed) == (1, 7, 1)
    assert pl.Simulator(other).rollout(THETA).loss == pl.Simulator(scene, seed=7).rollout(THETA).loss != found.loss


def test_what_was_found_comes_back_from_other_processes(found):
    again = pickle.loads(pickle.dumps(found))
    assert again == found and hash(again) == hash(found) and repr(again) == repr(found) and again.census == found.census
    assert again != object()


def test_a_motion_comes_back_from_other_processes(scene, simulator):
    motion = simulator.motion(scene.displacements(THETA)[:30], every=10)
    for again in (pickle.loads(pickle.dumps(motion, protocol=5)), copy.deepcopy(motion)):
        for name in ("times_s", "tool", "positions_m", "velocities_m_s"):
            np.testing.assert_array_equal(getattr(again, name), getattr(motion, name))
        assert again.evaluation == motion.evaluation and again.destinations == motion.destinations


def test_a_simulator_is_made_anew_where_it_arrives_and_is_not_used_after_a_fork(scene, found):
    simulator = pl.Simulator(scene, threads=1, memory="512MiB")
    again = pickle.loads(pickle.dumps(simulator))
    assert (again.scene, again.seed, again.precision) == (scene, simulator.seed, simulator.precision)
    assert again.rollout(THETA) == found
    child = os.fork()
    if child == 0:
        try:
            simulator.rollout(THETA)
        except RuntimeError as error:
            os._exit(0 if "forked" in str(error) else 1)
        os._exit(2)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_a_simulator_goes_with_what_its_progress_refers_to(scene):
    class Lab:
        def __init__(self):
            self.simulator = pl.Simulator(scene, threads=1, progress=self.tell)

        def tell(self, share):
            pass

    lab = weakref.ref(Lab())
    gc.collect()
    assert lab() is None


def test_equal_scenes_have_equal_hashes(scene):
    assert hash(scene) == hash(pl.Scene.from_dict(scene.to_dict()))
    assert len({scene, scene.replace(powder={"seed": 7})}) == 2


def test_memory_that_holds_no_gradient_is_refused(scene):
    with pytest.raises(ValueError, match="1 MiB"):
        pl.Simulator(scene, memory="1MiB").gradient(THETA)


def test_rollouts_side_by_side_are_the_same_as_alone(simulator, found):
    thetas = np.array([THETA, [0.5, 0.0, 0.0, 0.0, 0.3]])
    both = simulator.rollouts(thetas)
    assert both[0].loss == found.loss
    assert both[1].loss == simulator.rollout(thetas[1]).loss != found.loss
    assert simulator.rollouts(np.empty((0, 5))) == simulator.rollouts([]) == []


def test_gradients_of_every_kind(scene, simulator, found):
    slopes = {}
    for kind in ["adjoint", "restarted", "differences"]:
        evaluation, gradient = simulator.gradient(THETA, kind=kind)
        assert evaluation.loss == found.loss
        assert gradient.shape == (5,) and np.isfinite(gradient).all()
        slopes[kind] = gradient
    # The exact one is that of the motion, pulled back to theta. (The restarted one: see the search, which goes along it.)
    _, by_displacement = simulator.motion_gradient(scene.displacements(THETA))
    for component in range(5):
        step = np.zeros(5)
        step[component] = 1e-6
        moved = (scene.displacements(THETA + step) - scene.displacements(THETA - step)) / 2e-6
        assert slopes["adjoint"][component] == pytest.approx((by_displacement * moved).sum(), rel=1e-4, abs=1e-4), component
    assert (slopes["adjoint"] != slopes["restarted"]).any() and (slopes["restarted"] != slopes["differences"]).any()


def test_differences_end_where_the_range_ends(simulator):
    at_the_end = np.array([1.0, 0.0, 0.0, 0.0, -0.95])
    _, gradient = simulator.gradient(at_the_end, kind="differences", half_step=0.1)
    for component, low, high in [(0, 0.9, 1.0), (1, -0.1, 0.1), (4, -1.0, -0.85)]:
        below, above = np.tile(at_the_end, (2, 1))
        below[component], above[component] = low, high
        down, up = (simulator.rollout(theta).loss for theta in [below, above])
        assert down != up
        assert gradient[component] == pytest.approx((up - down) / (high - low), rel=1e-9), component


def test_a_motion_and_its_frames(scene, simulator, found):
    displacements = scene.displacements(THETA)
    motion = simulator.motion(displacements, every=100)
    assert motion.evaluation.loss == found.loss
    assert motion.positions_m.shape == (4, scene.particles, 3)
    assert motion.positions_m.dtype == np.float32
    assert motion.velocities_m_s.shape == motion.positions_m.shape
    assert motion.tool.shape == (4, 7)
    np.testing.assert_array_equal(motion.tool[0], scene.start_pose)
    np.testing.assert_allclose(motion.times_s, [0.0, 1.0, 2.0, 3.0])
    assert motion.destinations.count("target") == found.census["target"]
    # Without copies: each is one view of memory that Rust has handed over, and the same one whenever it is asked for.
    for array in [motion.positions_m, motion.velocities_m_s]:
        assert array.flags.c_contiguous and array.flags.writeable and not array.flags.owndata
    assert motion.positions_m is motion.positions_m and motion.velocities_m_s is motion.velocities_m_s
    elsewhere = scene.start_pose + np.array([0, 0, 0.01, 0, 0, 0, 0])
    assert simulator.motion(displacements[:10], every=10, start=elsewhere).tool[0, 2] == elsewhere[2]


def test_more_frames_than_there_is_memory_for_are_refused_before_anything_runs(file):
    program = """if True:
        import pathlib, resource, sys, numpy, powderline
        simulator = powderline.Simulator(powderline.Scene.load(sys.argv[1]), threads=1)
        still = numpy.zeros((100_000, 6))
        held = int(pathlib.Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        _, most = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (held + (1 << 28), most))
        try:
            simulator.motion(still, every=1)
        except MemoryError as error:
            print(error)
    """
    said = subprocess.run([sys.executable, "-c", program, file], check=True, capture_output=True, text=True, timeout=60).stdout
    assert re.match(r"100001 frames of \d+ particles take .* MiB, more than there is: a larger `every` keeps fewer", said), said


def test_a_motion_in_pieces_is_the_same_as_whole(scene, simulator, found):
    displacements = scene.displacements(THETA)
    episode = simulator.episode()
    episode.step(displacements[:100])
    assert episode.time_s == pytest.approx(1.0)
    whole = simulator.motion(displacements, every=100)
    np.testing.assert_array_equal(episode.positions_m, whole.positions_m[1])
    np.testing.assert_array_equal(episode.velocities_m_s, whole.velocities_m_s[1])
    np.testing.assert_array_equal(episode.tool, whole.tool[1])
    assert episode.step(displacements[100:]).loss == found.loss
    elsewhere = scene.start_pose + np.array([0, 0, 0.01, 0, 0, 0, 0])
    np.testing.assert_allclose(simulator.episode(start=elsewhere).tool, elsewhere, rtol=1e-12)


def test_a_loss_of_ones_own_is_differentiated(scene, simulator):
    displacements = scene.displacements(THETA)[:60]

    def mean_height(positions_m):
        slopes = np.zeros_like(positions_m)
        slopes[:, 2] = 1.0 / len(positions_m)
        return positions_m[:, 2].mean(), slopes

    height_m, gradient = simulator.motion_gradient(displacements, loss=mean_height)
    positions_m = simulator.motion(displacements, every=60).positions_m[-1]
    assert height_m == pytest.approx(positions_m[:, 2].mean(), rel=1e-5)
    assert gradient.shape == displacements.shape and (gradient != 0.0).any()
    loss, gradient = simulator.motion_gradient(displacements)
    assert loss > 0.0 and gradient.shape == displacements.shape

    def broken(positions_m):
        raise KeyError("of mine")

    with pytest.raises(KeyError, match="of mine"):
        simulator.motion_gradient(displacements, loss=broken)
    with pytest.raises(ValueError, match="shape"):
        simulator.motion_gradient(displacements, loss=lambda positions_m: (0.0, np.zeros((2, 3))))
    with pytest.raises(TypeError, match="must return a number and an array"):
        simulator.motion_gradient(displacements, loss=lambda positions_m: 3.0)
    # A search that passes over motions without an end does not pass over these.
    for answer in (lambda positions_m: (np.nan, np.zeros_like(positions_m)), lambda positions_m: (1.0, np.full_like(positions_m, np.nan))):
        with pytest.raises(ValueError, match="the loss returned .*but it must be finite"):
            simulator.motion_gradient(displacements, loss=answer)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda s: s.rollout(["a", 0, 0, 0, 0]), r"theta is \['a', 0, 0, 0, 0\], but it must be numbers of the shape \(5,\)"),
        (lambda s: s.rollout(np.array(["0.1"] * 5)), "theta is array"),
        (lambda s: s.rollout(None), r"theta is None, but it must be numbers of the shape \(5,\)"),
        (lambda s: s.rollouts([[0.0] * 5, [0.0]]), r"thetas is \[\[.*, but it must be numbers of the shape \(n, 5\)"),
        (lambda s: s.motion("still"), r"displacements is 'still', but it must be numbers of the shape \(n, 6\)"),
        (lambda s: pl.Simulator(s.scene, seed="one"), "seed is 'one', but it must be from 0 to"),
        (lambda s: pl.Simulator(s.scene, threads=1.5), "threads is 1.5, but it must be from 1 to 1024, or None"),
        (lambda s: s.motion(np.zeros((1, 6)), every="all"), "every is 'all', but it must be a whole number, 1 at least"),
        (lambda s: s.gradient(THETA, half_step="small"), "half_step is 'small', but it must be from 1e-9 to 1"),
        (lambda s: pl.optimise(s.scene, epochs="many"), "epochs is 'many', but it must be from 0 to 10000"),
        (lambda s: pl.Simulator(s.scene, 1), r"1 is given by its place, .* as in Simulator\(scene, seed=1\)"),
        (lambda s: s.gradient(THETA, "adjoint"), r"'adjoint' is given by its place, .* as in gradient\(theta, kind="),
        (lambda s: s.motion(np.zeros((1, 6)), 5), r"as in motion\(displacements, every=10\)"),
    ],
)
def test_what_is_no_number_or_has_no_name_is_a_sentence(simulator, call, sentence):
    with pytest.raises(TypeError, match=sentence):
        call(simulator)


def test_a_motion_out_of_the_volume_is_refused(scene, simulator):
    # Millimetres.
    away = np.zeros((20, 6))
    away[3, 0] = 5.0
    episode = simulator.episode()
    before = episode.tool
    for move in [simulator.motion, simulator.motion_gradient, episode.step]:
        with pytest.raises(ValueError, match=r"displacements\[3\] takes the tool to \[5.038, 0.032, 0.047\], out of the simulated volume"):
            move(away)
    np.testing.assert_array_equal(episode.tool, before)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda s: s.rollout([0.0, 0.0]), r"theta has the shape \(2,\), but it must be \(5,\)"),
        (lambda s: s.rollout([0.0, 0.0, 2.0, 0.0, 0.0]), r"theta's component 2 \(lift height\) is 2, outside \[-1, 1\]"),
        (lambda s: s.rollouts([[0.0, 0.0]]), r"thetas has the shape \(1, 2\), but it must be \(n, 5\)"),
        (lambda s: s.rollout([[0.0] * 5]), r"theta has the shape \(1, 5\)"),
        (lambda s: s.rollouts([[0.0] * 5, [0.0, 0.0, 2.0, 0.0, 0.0]]), r"thetas\[1, 2\] \(lift height\) is 2"),
        (lambda s: pl.Simulator(s.scene, seed=-1), "seed is -1"),
        (lambda s: s.motion(np.zeros((1, 6)), every=-1), "every is -1"),
        (lambda s: s.motion([[0.0] * 5 + [float("nan")]]), r"displacements\[0, 5\] is NaN"),
        (lambda s: s.motion(np.zeros((1, 6)), every=0), "every is 0"),
        (lambda s: s.motion(np.zeros((1, 6)), start=[0.0] * 7), "unit quaternion"),
        (lambda s: s.gradient(THETA, kind="exact"), '"adjoint", "restarted" or "differences"'),
        (lambda s: s.gradient(THETA, kind="restart"), 'kind is \'restart\', .*; did you mean "restarted"'),
        (lambda s: s.gradient(THETA, kind="differences", half_step=0.0), "half_step is 0"),
        (lambda s: pl.Simulator(s.scene, precision="f16"), '"f32" or "f64"'),
        (lambda s: pl.Simulator(s.scene, threads=0), "threads is 0, but it must be from 1 to 1024"),
        (lambda s: pl.Simulator(s.scene, threads=100_000), "threads is 100000"),
        (lambda s: pl.optimise(s.scene, threads=-1), "threads is -1"),
        (lambda s: pl.optimise(s.scene, precision="f16"), '"f32" or "f64"'),
        (lambda s: pl.optimise(s.scene, epochs=-1), "epochs is -1, but it must be from 0 to 10000"),
        (lambda s: pl.optimise(s.scene, epochs=100_001), "epochs is 100001"),
        (lambda s: pl.optimise(resume="runs/a", out="runs/b"), "out=.. for a new one, or resume=.., not both"),
        (lambda s: pl.Simulator(s.scene, memory="3 potatoes"), "memory: .*potatoes"),
        (lambda s: pl.Simulator(s.scene, memory=-1), "memory is -1, but it must be a size"),
        (lambda s: pl.Simulator(s.scene, memory=1.5), "memory is 1.5"),
    ],
)
def test_what_makes_no_sense_is_a_sentence(simulator, call, sentence):
    with pytest.raises(ValueError, match=sentence):
        call(simulator)


def test_plans_are_made_saved_loaded_and_turned_into_joints(scene, simulator, tmp_path):
    plan = simulator.plan(THETA)
    file = tmp_path / "skill.plan"
    plan.save(file)
    assert pl.Plan.load(file).scene is None
    (tmp_path / "scene.toml").write_text(scene.to_toml())
    again = pl.Plan.load(file)
    assert again.to_bytes() == plan.to_bytes() == file.read_bytes()
    assert again.scene == scene
    assert pickle.loads(pickle.dumps(plan)) == plan == again == pl.Plan.from_bytes(plan.to_bytes())
    np.testing.assert_array_equal(again.theta, THETA)
    assert simulator.motion(again.displacements, every=330).evaluation.loss == again.loss
    assert again.poses.shape == (331, 7) and again.times_s[-1] == pytest.approx(3.3)
    joints = again.to_joint_angles()
    assert joints.shape == (331, 6) and np.abs(np.diff(joints, axis=0)).max() < 0.1
    assert again.arm == "ur3e"
    achieved = simulator.motion(again.displacements).evaluation
    assert (again.miss, again.met, again.lost_kg) == (achieved.miss, achieved.met, achieved.lost_kg)
    assert (again.path_coefficients, again.finer_cell_m, again.own_mass_kg) == (0, None, again.mass_kg)
    assert again.met is False and "Plan(misses: " in repr(again)
    assert pl.Plan.from_bytes(plan.to_bytes()).met is None
    assert again.parameters["scooping_depth_m"] == scene.parameters(THETA)[0]
    assert "<table>" in again._repr_html_()
    with pytest.raises(pl.PlanError, match="digest"):
        again.to_joint_angles(scene=pl.Scene.load("vial"))
    file.write_bytes(b"nonsense")
    with pytest.raises(pl.PlanError, match="skill.plan"):
        pl.Plan.load(file)
    with pytest.raises(FileNotFoundError, match="no such file"):
        pl.Plan.load(tmp_path / "nowhere.plan")
    plan.save(tmp_path / "new" / "folder.plan")
    with pytest.raises(OSError, match="folder.plan"):
        plan.save(tmp_path / "new" / "folder.plan" / "below.plan")
    assert [file.name for file in (tmp_path / "new").iterdir()] == ["folder.plan"]
    # What comes with the package is known by itself, and another scene is refused.
    vial = pl.Scene.load("vial")
    with pytest.raises(pl.PlanError, match="'vial'|\"vial\" has"):
        pl.Plan.from_bytes(plan.to_bytes(), vial)
    assert pl.Plan.from_bytes(plan.to_bytes(), scene).met is False
    assert (again.precision, again.census) == (simulator.precision, achieved.census)


def test_a_plan_that_was_looked_at_on_smaller_cells_is_judged_by_them():
    golden = Path(__file__).parents[3] / "shared" / "tests" / "golden" / "plan-v4.plan"
    plan = pl.Plan.load(golden)
    assert (plan.finer_cell_m, plan.mass_kg, plan.own_mass_kg) == pytest.approx((0.002, 0.006701, 0.006824))
    assert plan.miss == pytest.approx(0.006701 / plan.wanted_kg - 1.0) and plan.lost_kg == pytest.approx(52e-6)
    assert repr(plan).startswith("Plan(6.701 g of 6.8 g (-1.5 %)")
    assert "6.701 g of 6.8 g wanted" in plan._repr_html_() and "<td>6.824 g</td>" in plan._repr_html_()


def test_a_search_is_the_programs(scene, simulator, tmp_path, capsys):
    file, told = tmp_path / "tiny.toml", []
    file.write_text(scene.to_toml())
    run = pl.optimise(scene, method="restarted", epochs=1, refine=False, out=tmp_path / "run", callback=told.append)
    _, gradient = simulator.gradient(told[0]["theta"], kind="restarted")
    np.testing.assert_array_equal(gradient, told[0]["slopes"]["adjoint"])
    assert [epoch["epoch"] for epoch in told] == [0, 1]
    # Which epoch becomes the plan is known in the end.
    assert [{**epoch, "shipped": None} for epoch in told] == [{**epoch, "shipped": None} for epoch in run.epochs]
    assert [epoch["shipped"] for epoch in run.epochs] == [False, True]
    # It misses, which is said first wherever the result is shown.
    assert run.plan is not None and run.met is run.plan.met is False and abs(run.miss) > 0.02
    assert f"{run!r}".startswith(f"Run({str(tmp_path / 'run')!r}: Plan(misses: ")
    assert "<td><b>misses</b>: " in run._repr_html_()
    said = capsys.readouterr().err
    assert "epoch   1/1" in said and said.endswith(run.summary)
    assert run.summary.startswith("The plan brings ") and "more than the tolerance of 2 %" in run.summary.splitlines()[0]
    subprocess.run(
        [sys.executable, "-m", "powderline", str(file)]
        + ["--method", "restarted", "--epochs", "1", "--no-refine", "--out", str(tmp_path / "program")],
        capture_output=True,
    )
    for file in ["skill.plan", "scene.toml"]:
        assert (tmp_path / "run" / file).read_bytes() == (tmp_path / "program" / file).read_bytes(), file
    program = pl.Run(tmp_path / "program")
    untimed = [[{**epoch, "seconds": 0, "work": 0} for epoch in found.epochs] for found in (program, run)]
    assert untimed[0] == untimed[1]
    assert "<svg" in run._repr_html_()
    assert run.scene == scene
    page = pl.report(run)
    assert page.path == tmp_path / "run" / "report.html" == pl.report(os.fspath(run)).path
    shown = page._repr_html_()
    assert shown.startswith("<iframe srcdoc=") and page.path.read_text(encoding="utf-8") in html.unescape(shown)
    plain = pl.report(run, replay=False, out=tmp_path / "plain.html")
    assert plain.path.stat().st_size < page.path.stat().st_size - 10_000
    with pytest.raises(ValueError, match="holds neither a run"):
        pl.report(tmp_path)
    with pytest.raises(FileNotFoundError, match="nowhere.html: there is no such page"):
        pl.Report(tmp_path / "nowhere.html")
    with pytest.raises(ValueError, match="run"):
        pl.optimise(scene, out=tmp_path / "run")
    with pytest.raises(ValueError, match="is a file"):
        pl.optimise(scene, out=tmp_path / "run" / "skill.plan")
    with pytest.raises(TypeError, match="callback is 3"):
        pl.optimise(scene, callback=3)
    with pytest.raises(ValueError, match="not both"):
        pl.optimise(scene, resume=tmp_path / "run")


def test_what_a_callback_raises_stops_the_search_and_the_run_stays_resumable(scene, tmp_path, capsys):
    def enough(epoch):
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        pl.optimise(scene, epochs=2, out=tmp_path / "run", callback=enough)
    assert f"go on with: optimise --resume {tmp_path / 'run'}" in capsys.readouterr().err
    assert len(pl.Run(tmp_path / "run").epochs) >= 1
    assert pl.Run(tmp_path / "run").plan is None


def test_ctrl_c_ends_a_gradient():
    simulator = pl.Simulator(pl.Scene.load("bench-small"), threads=1)
    # What a shell starts in the background does not hear it otherwise.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(1.0, lambda: os.kill(os.getpid(), signal.SIGINT))
    timer.start()
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        while time.monotonic() - began < 60.0:
            simulator.gradient(THETA, kind="differences")
    # And it goes on.
    assert simulator.rollout([0.0] * 5).loss > 0.0


def test_progress_is_told_and_can_stop(scene):
    shares = []
    pl.Simulator(scene, progress=shares.append).rollout(THETA)
    assert shares == sorted(shares) and shares[-1] == 1.0

    def stop(share):
        raise StopIteration

    with pytest.raises(StopIteration):
        pl.Simulator(scene, progress=stop).rollout(THETA)


def test_other_threads_of_python_run_meanwhile(scene):
    busy, at_work = [], threading.Event()
    simulator = pl.Simulator(scene, threads=1, progress=lambda share: at_work.set())

    def second():
        at_work.wait()
        try:
            simulator.rollout(THETA)
        except RuntimeError as error:
            busy.append(str(error))

    other = threading.Thread(target=second)
    other.start()
    # Long enough for the other one to come in between.
    simulator.rollouts([THETA] * 16)
    other.join()
    assert len(busy) == 1 and "another thread" in busy[0]
