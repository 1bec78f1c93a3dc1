use powderline_optimiser::rollout::{self, Simulator};
use powderline_optimiser::scene::Scene;
use powderline_optimiser::skill::SkillMap;
use powderline_shared::displacement::Displacement;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let scene = Scene::load(&args[1]).unwrap();
    let theta: Vec<f64> = args[2].split(',').map(|x| x.parse().unwrap()).collect();
    let theta: [f64;5] = theta.try_into().unwrap();
    let n: usize = args[3].parse().unwrap();
    let map = SkillMap::new(&scene);
    let d = |u: &[f64;6]| Displacement { translation_m: [u[0],u[1],u[2]], rotation_rad: [u[3],u[4],u[5]] };
    let mut sim: Simulator<f64> = rollout::simulator(&scene, 1, 2, 1<<30).unwrap();
    let lin = map.linearise(&theta).unwrap();
    let t0 = std::time::Instant::now();
    let (e, bars) = sim.control_gradient(lin.controls[..n].iter().map(d).collect(), &mut |_, _| true).unwrap();
    let tg = t0.elapsed().as_secs_f64();
    let g = lin.pull_back(&bars);
    println!("loss {} grad {g:?} {tg:.2}s", e.loss);
    for k in 0..5 {
        for h in [1e-3, 1e-4, 1e-5, 1e-6, 1e-7] {
            let mut at = |h: f64| { let mut t = theta; t[k] += h; let c = map.controls(&t).unwrap();
              let p = sim.final_positions(c[..n].iter().map(d).collect(), &mut |_, _| true).unwrap();
              let t = scene.objective.p_target_m;
              p.iter().map(|p| ((p[0]-t[0]).powi(2)+(p[1]-t[1]).powi(2)+(p[2]-t[2]).powi(2)).sqrt()).sum::<f64>() };
            let fd = (at(h) - at(-h)) / (2.0*h);
            println!("{k} h {h:e} fd {fd:.10e} adj {:.10e} rel {:.2e}", g[k], (fd - g[k]) / fd);
        }
        if n < 60 && k == 0 { break; }
    }
}
