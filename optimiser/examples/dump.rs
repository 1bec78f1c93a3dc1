use powderline_optimiser::rollout::{self, Simulator};
use powderline_optimiser::scene::Scene;
use powderline_optimiser::skill::SkillMap;
use powderline_shared::displacement::Displacement;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let scene = Scene::load(&args[1]).unwrap();
    let theta: Vec<f64> = args[2].split(',').map(|x| x.parse().unwrap()).collect();
    let theta: [f64;5] = theta.try_into().unwrap();
    let map = SkillMap::new(&scene);
    for s in map.segments(&theta) { eprintln!("{s:?}"); }
    let u: Vec<Displacement> = map.controls(&theta).unwrap().iter().map(|u| Displacement { translation_m: [u[0],u[1],u[2]], rotation_rad: [u[3],u[4],u[5]] }).collect();
    let mut sim: Simulator<f32> = rollout::simulator(&scene, 1, 2, 1<<30).unwrap();
    for t in args[3].split(',') {
        let n: usize = t.parse().unwrap();
        let p = sim.final_positions(u[..n].to_vec(), &mut |_, _| true).unwrap();
        let (mut x, mut a) = ([scene.tool.start_position_m[0], scene.tool.start_position_m[1], scene.tool.start_position_m[2]], scene.tool.start_pitch_deg.to_radians());
        for u in &u[..n] { for i in 0..3 { x[i] += u.translation_m[i]; } a += u.rotation_rad[1]; }
        let mut out = format!("{} {} {}\n", x[0], x[2], a);
        for q in p { out += &format!("{} {} {}\n", q[0], q[1], q[2]); }
        std::fs::write(format!("/tmp/dump/{n}.txt"), out).unwrap();
    }
}
