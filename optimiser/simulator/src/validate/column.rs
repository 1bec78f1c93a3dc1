//! Columns that collapse on a plate: how far the powder runs out, how high it stays, and what becomes of its
//! energy.

use crate::real::Real;
use crate::scene::SceneSpec;
use crate::validate::Scope;
use crate::validate::case::{Case, Claim, Halt, Meter};
use crate::validate::measures::Deposit;
use crate::validate::rig::{
    FRICTION_ANGLE, GRAVITY, PERIOD_S, Rig, apparatus, fall_speed, packed_cylinder, set_time_step,
};

/// Radius of the column, m.
const RADIUS_M: f64 = 0.024;

/// When the deposit is looked at, s: three times what the tallest column takes (Lube et al.: `3 sqrt(h/g)`),
/// and more.
const END_S: f64 = 0.8;

/// A column of powder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Column {
    /// Height over radius.
    pub(super) aspect: f64,
    pub(super) cells_per_radius: u32,
    /// Substeps over those of a stable step.
    pub(super) substeps: f64,
    pub(super) youngs_modulus_pa: f64,
    pub(super) friction_angle_deg: f64,
}

/// What is left of it.
pub(super) struct Collapsed {
    deposit: Deposit,
    /// Largest rise of the energy from one control step to the next, over what the column could fall by.
    energy_rise: f64,
}

impl Column {
    pub(super) const fn new(aspect: f64, cells_per_radius: u32) -> Self {
        Self {
            aspect,
            cells_per_radius,
            substeps: 1.0,
            youngs_modulus_pa: super::rig::YOUNGS_MODULUS,
            friction_angle_deg: FRICTION_ANGLE,
        }
    }

    fn height_m(&self) -> f64 {
        self.aspect * RADIUS_M
    }

    /// Half the plate's width, m: further than sand runs out, and room besides.
    fn reach_m(&self) -> f64 {
        RADIUS_M * (1.5 + 1.5 * run_out(self.aspect))
    }

    pub(super) fn scene(&self, law: &SceneSpec) -> SceneSpec {
        let cell = RADIUS_M / f64::from(self.cells_per_radius);
        let width = 2.0 * self.reach_m();
        let mut scene = apparatus(law, [width, width, self.height_m() + 6.0 * cell], cell);
        scene.powder.youngs_modulus_pa = self.youngs_modulus_pa;
        scene.powder.friction_angle_deg = self.friction_angle_deg;
        set_time_step(&mut scene, fall_speed(self.height_m()));
        scene.time.substeps = (f64::from(scene.time.substeps) * self.substeps).ceil() as u32;
        scene
    }

    /// Particles times substeps.
    pub(super) fn work(&self, law: &SceneSpec) -> f64 {
        let scene = self.scene(law);
        let volume = core::f64::consts::PI * RADIUS_M * RADIUS_M * self.height_m();
        volume / scene.particle_volume_m3() * END_S / scene.time.substep_s()
    }

    pub(super) fn collapse<T: Real>(
        &self,
        law: &SceneSpec,
        seed: u64,
        meter: &Meter<'_>,
    ) -> Result<Collapsed, Halt> {
        let scene = self.scene(law);
        let middle = 0.5 * scene.domain.size_m[0];
        let column = packed_cylinder(&scene, [middle, middle, 0.0], RADIUS_M, self.height_m(), seed);
        let fall = column.len() as f64 * scene.particle_mass_kg() * GRAVITY * 0.5 * self.height_m();
        let volume = scene.particle_volume_m3();
        let mut rig = Rig::<T>::new(scene, &column)?;
        let (mut energy, mut rise) = (rig.energy(), 0.0f64);
        for _ in 0..(END_S / PERIOD_S).round() as usize {
            rig.run(PERIOD_S, meter)?;
            let now = rig.energy();
            rise = rise.max(now - energy);
            energy = now;
        }
        let deposit = Deposit::new(&rig.positions(), [middle; 2], volume);
        Ok(Collapsed { deposit, energy_rise: rise / fall })
    }
}

impl Collapsed {
    /// Run-out over the radius by what holds 99 % of the powder, and by where it is a grain thick.
    fn run_outs(&self) -> [f64; 2] {
        [self.deposit.radius_of(0.99), self.deposit.front()].map(|radius| (radius - RADIUS_M) / RADIUS_M)
    }

    /// The first of these.
    pub(super) fn run_out(&self) -> f64 {
        self.run_outs()[0]
    }

    /// Height of the top over the radius.
    fn height(&self) -> f64 {
        self.deposit.apex(0.6 * RADIUS_M) / RADIUS_M
    }
}

/// Run-out of sand over the column's radius.
fn run_out(aspect: f64) -> f64 {
    if aspect < 1.7 { 1.24 * aspect } else { 1.6 * aspect.sqrt() }
}

/// Height of its deposit over the column's radius.
fn height(aspect: f64) -> f64 {
    aspect.min(0.88 * libm::pow(aspect, 1.0 / 6.0))
}

/// What is claimed of the run-out, by either measure.
pub(super) fn claim_of_run_out(column: &Column, measure: &str) -> Claim {
    let Column { aspect, cells_per_radius, .. } = column;
    let claim = Claim {
        group: "collapse of a column, lengths over its radius",
        name: format!("run-out, a = {aspect}, {cells_per_radius} cells per radius, {measure}"),
        unit: "",
        reference: run_out(*aspect),
        tolerance: [0.0; 2],
        source: "Lube, Huppert, Sparks and Hallworth 2004, J. Fluid Mech. 508: 1.24 a for a < 1.7, 1.6 \
                 sqrt(a) above, for sands that rest at about 30 deg, whatever the plate",
        why: "15 %: the scatter of the experiments about their law, and what takes the edge for the last \
              grain instead of the heap's",
        wrong: ["The powder stops {} short of where sand does", "The powder runs {} farther than sand"],
        control: false,
    };
    claim.within_share(0.15)
}

/// What is claimed of the height.
fn claim_of_height(column: &Column) -> Claim {
    let Column { aspect, cells_per_radius, .. } = column;
    let claim = Claim {
        group: "collapse of a column, lengths over its radius",
        name: format!("height, a = {aspect}, {cells_per_radius} cells per radius"),
        unit: "",
        reference: height(*aspect),
        tolerance: [0.0; 2],
        source: "Lube et al. 2004, as others quote it: a until the top crumbles, then 0.88 a^(1/6)",
        why: "15 %: as for the run-out",
        wrong: ["The deposit is {} lower than sand's", "The deposit is {} higher than sand's"],
        control: false,
    };
    claim.within_share(0.15)
}

/// What is claimed of the energy.
fn claim_of_energy() -> Claim {
    Claim {
        group: "energy",
        name: "largest rise in 10 ms of a collapse, over all it can lose".into(),
        unit: "",
        reference: 0.0,
        tolerance: [0.0, 1e-3],
        source: "nothing drives the powder: kinetic, elastic and potential energy together can only fall",
        why: "a thousandth: the error of a step of time, and the push that brings particles back out of walls",
        wrong: ["", "Energy comes from nowhere: {}"],
        control: false,
    }
}

fn case(law: &SceneSpec, column: Column, seeds: u64) -> Case<'_> {
    let mut claims = vec![
        claim_of_run_out(&column, "99 %"),
        claim_of_run_out(&column, "one grain thick"),
        claim_of_height(&column),
    ];
    let of_energy = column == Column::new(1.0, 6);
    claims.extend(of_energy.then(claim_of_energy));
    let measure = move |seed, meter: &Meter<'_>| {
        let left = column.collapse::<f32>(law, seed, meter)?;
        let [most, front] = left.run_outs();
        let all = [most, front, left.height(), left.energy_rise];
        Ok(all[..if of_energy { 4 } else { 3 }].to_vec())
    };
    Case { claims, seeds, work: column.work(law), measure: Box::new(measure) }
}

/// Columns of these aspect ratios.
pub(super) fn cases(law: &SceneSpec, scope: Scope) -> Vec<Case<'_>> {
    let coarse = [0.5, 1.0, 2.0, 4.0].map(|aspect| (Column::new(aspect, 6), scope.seeds()));
    let fine: &[f64] = if scope == Scope::Full { &[0.5, 1.0, 1.5, 2.0, 3.0, 4.0] } else { &[1.0] };
    // Seeds differ less there, and cost sixteen times as much.
    let fine = fine.iter().map(|aspect| (Column::new(*aspect, 12), 1));
    coarse.into_iter().chain(fine).map(|(column, seeds)| case(law, column, seeds)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{DEFAULT_SCENE, Scene};

    #[test]
    fn the_laws_of_lube_et_al_are_theirs() {
        for (aspect, wanted) in [(0.5, 0.62), (1.0, 1.24), (2.0, 2.2627), (4.0, 3.2)] {
            assert!((run_out(aspect) - wanted).abs() < 1e-4, "{aspect}");
        }
        for (aspect, wanted) in [(0.5, 0.5), (1.0, 0.88), (2.0, 0.9878), (4.0, 1.1087)] {
            assert!((height(aspect) - wanted).abs() < 1e-4, "{aspect}");
        }
    }

    #[test]
    fn a_column_stands_as_wide_and_high_as_it_says_before_it_falls() {
        let law = Scene::load(DEFAULT_SCENE).unwrap();
        let column = Column::new(2.0, 6);
        let scene = column.scene(&law);
        let middle = 0.5 * scene.domain.size_m[0];
        let points = packed_cylinder(&scene, [middle, middle, 0.0], RADIUS_M, column.height_m(), 1);
        let deposit = Deposit::new(&points, [middle; 2], scene.particle_volume_m3());
        let standing = Collapsed { deposit, energy_rise: 0.0 };
        let [most, front] = standing.run_outs();
        // A cliff is seen a ring and a half too far out.
        assert!(most.abs() < 0.01 && (0.0..0.13).contains(&front), "{most} {front}");
        assert!((standing.height() - 2.0).abs() < 0.02, "{}", standing.height());
        let work = points.len() as f64 * END_S / scene.time.substep_s();
        assert!((column.work(&law) / work - 1.0).abs() < 0.02);
    }
}
