//! What must not matter: the time step, the stiffness that stands for rigid grains, the number format.

use crate::scene::SceneSpec;
use crate::validate::Scope;
use crate::validate::case::{Case, Claim, Halt, Meter};
use crate::validate::column::Column;
use crate::validate::rig::YOUNGS_MODULUS;

/// The column that is changed.
const COLUMN: Column = Column::new(1.0, 6);

fn claim(name: String, why: &'static str) -> Claim {
    Claim {
        group: "independence of what is numerical",
        name: format!("run-out, a = 1, {name}"),
        unit: "",
        reference: 1.0,
        tolerance: [0.0; 2],
        source: "the same column with the usual time step and E = 10 kPa, in f32",
        why,
        wrong: ["The powder stops {} earlier", "The powder runs {} farther"],
        control: false,
    }
}

fn case(law: &SceneSpec, claim: Claim, seeds: u64, other: Column) -> Case<'_> {
    let measure = move |seed, meter: &Meter<'_>| {
        let usual = COLUMN.collapse::<f32>(law, seed, meter)?.run_out();
        Ok::<_, Halt>(vec![other.collapse::<f32>(law, seed, meter)?.run_out() / usual])
    };
    let work = COLUMN.work(law) + other.work(law);
    Case { claims: vec![claim], seeds, work, measure: Box::new(measure) }
}

/// The largest time step that a scene may have, over that of the column.
fn longest_step(law: &SceneSpec) -> f64 {
    let mut scene = COLUMN.scene(law);
    let usual = scene.time.substeps;
    super::rig::set_time_step(&mut scene, 0.0);
    f64::from(scene.time.substeps) / f64::from(usual)
}

/// All of it.
pub(super) fn cases(law: &SceneSpec, scope: Scope) -> Vec<Case<'_>> {
    let seeds = scope.seeds();
    let of_step = "6 %: a time step that is stable is small; what is lost in each of them must not add up";
    let steps = [("the longest time step", longest_step(law)), ("a quarter of the time step", 4.0)];
    let steps = steps.map(|(name, substeps)| {
        case(law, claim(name.into(), of_step).within(0.06), seeds, Column { substeps, ..COLUMN })
    });
    let of_stiffness = "6 %: the column is squeezed by a hundredth under its weight at 10 kPa, at 1 kPa by a \
                        tenth, which is powder too soft to be called grains";
    let moduli: &[f64] = if scope == Scope::Full { &[1e3, 1e5, 1e6] } else { &[1e3, 1e5] };
    let moduli = moduli.iter().map(|modulus| {
        let name = format!("E = {} kPa over {} kPa", modulus / 1e3, YOUNGS_MODULUS / 1e3);
        let column = Column { youngs_modulus_pa: *modulus, ..COLUMN };
        case(law, claim(name, of_stiffness).within(0.06), seeds, column)
    });
    let measure = move |seed, meter: &Meter<'_>| {
        let wide = COLUMN.collapse::<f64>(law, seed, meter)?.run_out();
        Ok(vec![100.0 * (COLUMN.collapse::<f32>(law, seed, meter)?.run_out() / wide - 1.0)])
    };
    let why = "0.5 %: single grains part ways, but the deposit is the same";
    let of_format = Claim { unit: "%", reference: 0.0, ..claim("f32 less f64".into(), why) };
    let formats = Case {
        claims: vec![of_format.within(0.5)],
        seeds,
        work: 3.0 * COLUMN.work(law),
        measure: Box::new(measure),
    };
    steps.into_iter().chain(moduli).chain([formats]).collect()
}
