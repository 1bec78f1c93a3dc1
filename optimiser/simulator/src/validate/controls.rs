//! Lines that must fail, because something is broken on purpose: if they do not, the lines that they are made
//! of prove nothing.

use crate::scene::SceneSpec;
use crate::validate::case::{Case, Claim, Meter};
use crate::validate::column::{self, Column};
use crate::validate::element::{self, Device};
use crate::validate::rig::FRICTION_ANGLE;
use crate::validate::{heap, packing};

/// Makes a control of a claim.
fn broken(claim: Claim, how: &str) -> Claim {
    Claim {
        group: "controls",
        name: format!("{how}: {}", claim.name),
        why: "that of the line that is broken; the number has to lie outside",
        control: true,
        ..claim
    }
}

/// All of them.
pub(super) fn cases(law: &SceneSpec) -> Vec<Case<'_>> {
    let column = Column { friction_angle_deg: 0.0, ..Column::new(1.0, 6) };
    let liquid = Case {
        claims: vec![broken(column::claim_of_run_out(&column, "99 %"), "no friction")],
        seeds: 1,
        work: column.work(law),
        measure: Box::new(move |seed, meter| Ok(vec![column.collapse::<f32>(law, seed, meter)?.run_out()])),
    };
    let flat = Case {
        claims: vec![broken(heap::claim(FRICTION_ANGLE), "no friction")],
        seeds: 1,
        work: heap::work(law, FRICTION_ANGLE),
        measure: Box::new(|seed, meter| Ok(vec![heap::slope_deg(law, FRICTION_ANGLE, 0.0, seed, meter)?])),
    };
    let keys = [25.0, 35.0];
    let wrong_cone = Case {
        claims: keys.map(|key| broken(element::claim(Device::TriaxialCompression, key), "wrong cone")).into(),
        seeds: 1,
        work: 0.0,
        measure: Box::new(move |_, _| {
            let angle = |key| element::angle_of_wrong_cone_deg(law, Device::TriaxialCompression, key);
            Ok(keys.map(angle).into())
        }),
    };
    let [back, _] = element::claims_of_volume();
    let forgetful = Case {
        claims: vec![broken(back, "no volume correction")],
        seeds: 1,
        work: 0.0,
        measure: Box::new(|_, _| Ok(vec![element::pressures_after_expansion(law, true)[0]])),
    };
    let [median, ..] = packing::claims("box", 0.004, [0.95, 1.05]);
    let swollen = Case {
        claims: vec![broken(median, "no volume correction")],
        seeds: 1,
        work: packing::work_of_box(law, 0.004),
        measure: Box::new(|seed, meter: &Meter<'_>| {
            Ok(vec![packing::in_box(law, 0.004, true, seed, meter)?[0]])
        }),
    };
    vec![wrong_cone, forgetful, liquid, flat, swollen]
}
