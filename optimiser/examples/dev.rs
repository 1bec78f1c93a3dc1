use powderline_optimiser::rollout::{self, Evaluate, Simulator};
use powderline_optimiser::scene::Scene;
use powderline_optimiser::real::Real;
fn run<T: Real>(scene: &Scene, args: &[String]) {
    let threads: usize = args[2].parse().unwrap();
    let theta: Vec<f64> = args[3].split(',').map(|x| x.parse().unwrap()).collect();
    let theta: [f64;5] = theta.try_into().unwrap();
    let grad = args[4] == "grad";
    let mut sim: Simulator<T> = rollout::simulator(scene, 1, threads, 1<<30).unwrap();
    let t = std::time::Instant::now();
    let n = scene.particle_count() as f64 * scene.time.horizon_steps as f64 * scene.time.substeps as f64;
    let e = sim.evaluate(&theta, grad, &mut |_, _| true);
    let s = t.elapsed().as_secs_f64();
    println!("{e:?} {s:.2} s, {:.1} ns per particle-substep (settle {:.3})", s*1e9/n, scene.time.settle_s);
}
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let scene = Scene::load(&args[1]).unwrap();
    println!("{} particles {} steps x {}", scene.particle_count(), scene.time.horizon_steps, scene.time.substeps);
    if args[5] == "f32" { run::<f32>(&scene, &args) } else { run::<f64>(&scene, &args) }
}
