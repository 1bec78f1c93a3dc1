//! Powder that flows out of a silo through a round hole in its flat bottom or at the end of a cone, or through a slot in the bottom of a box,
//! by how many cells that is across.

use std::f64::consts::PI;

use crate::scene::{Container, ContainerShape, SceneSpec};
use crate::validate::Scope;
use crate::validate::case::{Case, Claim, Halt, Meter};
use crate::validate::rig::{GRAVITY, PERIOD_S, Rig, apparatus, packed, packed_cylinder, set_time_step};

/// Cell, m.
const CELL_M: f64 = 0.004;

/// Diameter of the silo, height of the powder in it, and height of the hole above the floor, over the hole's diameter or the slot's width: so wide and so full
/// that neither matters (Beverloo's law needs 2.5, or 30 grains beside the hole, and as much powder above it as the silo is wide), and so high
/// that what has come out is not in the way.
const WIDE: f64 = 2.5;
const HIGH: f64 = 2.5;
const ABOVE: f64 = 1.6;
/// Width of the place below, over the hole's diameter.
const BELOW: f64 = 4.8;
/// Length of a slot over its width, at which what its ends do counts little, and height of the powder above it: more flows through a slot
/// than through a hole.
const LONG: f64 = 3.0;
const HIGH_SLOT: f64 = 4.0;

/// From when and until when the flow is measured, in times that a grain takes to fall half the hole's diameter: it is steady by then, and a
/// third of the powder is still to come.
const BEGINS: f64 = 3.0;
const ENDS: f64 = 7.0;
/// The same of a slot.
const BEGINS_SLOT: f64 = 2.0;
const ENDS_SLOT: f64 = 4.0;

/// Beverloo's constant.
const BEVERLOO: f64 = 0.58;
/// That of slots.
const MYERS_SELLERS: f64 = 1.03;

/// Rose and Tanaka's exponent of the tangents of a cone's half angle, and of the angle at which powder stands still beside a hole in a flat
/// bottom: 45 degrees, where nobody has measured it.
const ROSE_TANAKA: f64 = -0.35;

/// What powder flows through.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Outlet {
    /// A round hole in a flat bottom.
    Hole,
    /// The end of a cone by half of its angle, degrees.
    Cone(f64),
    /// A slot across the flat bottom of a box.
    Slot,
}

/// A silo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Silo {
    outlet: Outlet,
    /// Diameter of its hole, or width of its slot, cells.
    pub(super) opening_cells: f64,
    /// How far its middle is off a node, cells, along x and y.
    pub(super) off_cells: f64,
    /// Substeps over those of a stable step.
    pub(super) substeps: f64,
    pub(super) youngs_modulus_pa: f64,
}

impl Silo {
    pub(super) const fn new(opening_cells: f64, off_cells: f64) -> Self {
        let (substeps, youngs_modulus_pa) = (1.0, super::rig::YOUNGS_MODULUS);
        Self { outlet: Outlet::Hole, opening_cells, off_cells, substeps, youngs_modulus_pa }
    }

    const fn with(outlet: Outlet, opening_cells: f64, off_cells: f64) -> Self {
        Self { outlet, ..Self::new(opening_cells, off_cells) }
    }

    fn opening_m(&self) -> f64 {
        self.opening_cells * CELL_M
    }

    /// Height of the powder.
    fn height_m(&self) -> f64 {
        let high = if self.outlet == Outlet::Slot { HIGH_SLOT } else { HIGH };
        high * self.opening_m()
    }

    /// From when and until when its flow is measured, s, in whole control periods.
    fn measured_s(&self) -> [f64; 2] {
        let units = if self.outlet == Outlet::Slot { [BEGINS_SLOT, ENDS_SLOT] } else { [BEGINS, ENDS] };
        units.map(|units| (units * self.unit_s() / PERIOD_S).ceil() * PERIOD_S)
    }

    fn unit_s(&self) -> f64 {
        (self.opening_m() / GRAVITY).sqrt()
    }

    /// What flows through by Beverloo's law, Rose and Tanaka's of cones, and Myers and Sellers' of slots, kg/s.
    fn law(&self, density_kg_m3: f64) -> f64 {
        let constant = match self.outlet {
            Outlet::Hole => BEVERLOO,
            Outlet::Cone(half_angle_deg) => {
                BEVERLOO * libm::pow(libm::tan(half_angle_deg.to_radians()), ROSE_TANAKA)
            }
            Outlet::Slot => MYERS_SELLERS * LONG,
        };
        constant * density_kg_m3 * GRAVITY.sqrt() * libm::pow(self.opening_m(), 2.5)
    }

    /// Middle of the hole, m.
    fn middle_m(&self) -> [f64; 3] {
        let cells = (0.5 * BELOW * self.opening_cells).ceil() + self.off_cells;
        let above = (ABOVE * self.opening_cells).ceil();
        [cells * CELL_M, cells * CELL_M, above * CELL_M]
    }

    fn shape(&self) -> ContainerShape {
        let opening = self.opening_m();
        let (inner_radius_m, outlet_radius_m) = (0.5 * WIDE * opening, 0.5 * opening);
        let inner_height_m = self.height_m() + 2.0 * CELL_M;
        match self.outlet {
            Outlet::Hole => ContainerShape::Silo { inner_radius_m, inner_height_m, outlet_radius_m },
            Outlet::Cone(half_angle_deg) => {
                ContainerShape::Hopper { inner_radius_m, inner_height_m, outlet_radius_m, half_angle_deg }
            }
            Outlet::Slot => ContainerShape::SlottedBox {
                inner_size_m: [WIDE * opening, LONG * opening, inner_height_m],
                slot_width_m: opening,
            },
        }
    }

    fn scene(&self, law: &SceneSpec) -> SceneSpec {
        let middle = self.middle_m();
        let width = 2.0 * middle[0].max(middle[1]) + CELL_M;
        let mut scene = apparatus(law, [width, width, middle[2] + self.height_m() + 4.0 * CELL_M], CELL_M);
        scene.powder.youngs_modulus_pa = self.youngs_modulus_pa;
        scene.containers.push(Container {
            name: "silo".into(),
            position_m: middle,
            yaw_deg: 0.0,
            wall_thickness_m: CELL_M,
            friction: scene.domain.friction,
            shape: self.shape(),
        });
        set_time_step(&mut scene, super::rig::fall_speed(middle[2]));
        scene.time.substeps = (f64::from(scene.time.substeps) * self.substeps).ceil() as u32;
        scene
    }

    /// What it is filled with at first.
    fn powder(&self, scene: &SceneSpec, seed: u64) -> Vec<[f64; 3]> {
        let (middle, shape, height) = (self.middle_m(), self.shape(), self.height_m());
        if let ContainerShape::SlottedBox { inner_size_m: [length, width, _], .. } = shape {
            let [x, y, z] = middle;
            let (low, high) =
                ([x - 0.5 * length, y - 0.5 * width, z], [x + 0.5 * length, y + 0.5 * width, z + height]);
            return packed(scene, low, high, seed);
        }
        let mut powder = packed_cylinder(scene, middle, 0.5 * WIDE * self.opening_m(), height, seed);
        powder.retain(|p| {
            let rho = libm::hypot(p[0] - middle[0], p[1] - middle[1]);
            shape.inner_radius_at_m(p[2] - middle[2]).is_some_and(|inner| rho <= inner)
        });
        powder
    }

    /// Particles times substeps.
    fn work(&self, law: &SceneSpec) -> f64 {
        let scene = self.scene(law);
        let base = match self.outlet {
            // A cone takes a part of it.
            Outlet::Hole | Outlet::Cone(_) => 0.25 * PI * WIDE * WIDE,
            Outlet::Slot => WIDE * LONG,
        };
        let volume = base * self.opening_m().powi(2) * self.height_m();
        let [_, ends_s] = self.measured_s();
        volume / scene.particle_volume_m3() * ends_s / scene.time.substep_s()
    }

    /// What flows through over what does by the outlet's law.
    pub(super) fn flow(&self, law: &SceneSpec, seed: u64, meter: &Meter<'_>) -> Result<f64, Halt> {
        let scene = self.scene(law);
        let (mass, reference) = (scene.particle_mass_kg(), self.law(scene.powder.density_kg_m3));
        let powder = self.powder(&scene, seed);
        let mut rig = Rig::<f32>::new(scene, &powder)?;
        let floor_m = self.middle_m()[2] - CELL_M;
        let through = |rig: &Rig<f32>| rig.positions().iter().filter(|p| p[2] < floor_m).count() as f64;
        let [begins, ends] = self.measured_s();
        rig.run(begins, meter)?;
        let before = through(&rig);
        rig.run(ends - begins, meter)?;
        Ok((through(&rig) - before) * mass / (ends - begins) / reference)
    }
}

/// What is claimed of the flow.
fn claim(silo: &Silo) -> Claim {
    let Silo { opening_cells, off_cells, outlet, .. } = silo;
    let place = if *off_cells == 0.0 { String::new() } else { format!(", {off_cells} cells off a node") };
    let claim = Claim {
        group: match outlet {
            Outlet::Hole => "flow out of a flat-bottomed silo, over Beverloo's law",
            Outlet::Cone(_) => "flow out of a hopper, over Rose and Tanaka's law",
            Outlet::Slot => "flow out of a flat-bottomed box, over Beverloo's law for slots",
        },
        name: match outlet {
            Outlet::Hole => format!("hole {opening_cells} cells across{place}"),
            Outlet::Cone(angle) => format!("{angle} deg, hole {opening_cells} cells across{place}"),
            Outlet::Slot => format!("slot {opening_cells} cells wide{place}"),
        },
        unit: "",
        reference: 1.0,
        tolerance: [0.0; 2],
        source: match outlet {
            Outlet::Hole => {
                "Beverloo, Leniger and van de Velde 1961, Chem. Eng. Sci. 15: 0.58 rho sqrt(g) D^2.5, for grains much smaller than the hole"
            }
            Outlet::Cone(_) => {
                "Rose and Tanaka 1959, The Engineer 208: tan(half angle)^-0.35 of what flows through a flat bottom (powder beside that hole stands at 45 deg)"
            }
            Outlet::Slot => {
                "Myers and Sellers 1978, in Nedderman 1992, Statics and Kinematics of Granular Materials, ch. 10: 1.03 rho sqrt(g) L B^1.5, for grains much smaller than the slot"
            }
        },
        why: "20 %: what the constant differs by between grains",
        wrong: ["{} less flows out than of sand", "{} more flows out than of sand"],
        control: false,
    };
    claim.within_share(0.2)
}

/// Holes spread over how they lie between nodes.
pub(super) fn cases(law: &SceneSpec, scope: Scope) -> Vec<Case<'_>> {
    let full: &[[f64; 2]] = &[
        [4.0, 0.0],
        [6.0, 0.0],
        [8.0, 0.25],
        [10.0, 0.0],
        [12.0, 0.0],
        [12.0, 0.5],
        [12.5, 0.25],
        [13.0, 0.0],
        [14.0, 0.5],
        [16.0, 0.0],
    ];
    let silos: &[[f64; 2]] = if scope == Scope::Full { full } else { &[[6.0, 0.0], [12.0, 0.0]] };
    let case = |silo: Silo| {
        let measure = move |seed, meter: &Meter<'_>| Ok(vec![silo.flow(law, seed, meter)?]);
        Case { claims: vec![claim(&silo)], seeds: 1, work: silo.work(law), measure: Box::new(measure) }
    };
    let silos = silos.iter().map(|[opening_cells, off_cells]| Silo::new(*opening_cells, *off_cells));
    let hoppers: &[[f64; 3]] = &[
        [30.0, 4.0, 0.0],
        [30.0, 6.0, 0.5],
        [30.0, 8.0, 0.25],
        [30.0, 10.0, 0.0],
        [30.0, 12.0, 0.0],
        [30.0, 12.0, 0.5],
        [30.0, 12.5, 0.25],
        [30.0, 13.0, 0.0],
        [30.0, 14.0, 0.5],
        [30.0, 16.0, 0.0],
        [20.0, 12.0, 0.0],
        [45.0, 12.0, 0.0],
    ];
    let hoppers = if scope == Scope::Full { hoppers } else { &hoppers[1..2] };
    let hoppers =
        hoppers.iter().map(|[angle, opening, off]| Silo::with(Outlet::Cone(*angle), *opening, *off));
    let slots: &[[f64; 2]] = &[[4.0, 0.0], [6.0, 0.5], [8.0, 0.25], [10.0, 0.0], [12.0, 0.0]];
    let slots = if scope == Scope::Full { slots } else { &[] };
    let slots = slots.iter().map(|[opening, off]| Silo::with(Outlet::Slot, *opening, *off));
    let of_numerics = (scope == Scope::Full).then(|| numerics(law));
    silos.chain(hoppers).chain(slots).map(case).chain(of_numerics).collect()
}

/// Whether the flow hangs on numbers that are none of the powder's: half the step of time, and four times the stiffness.
fn numerics(law: &SceneSpec) -> Case<'_> {
    let usual = Silo::new(8.0, 0.0);
    let others =
        [Silo { substeps: 2.0, ..usual }, Silo { youngs_modulus_pa: 4.0 * usual.youngs_modulus_pa, ..usual }];
    let claims = ["half the step of time", "four times as stiff"].map(|name| {
        let claim = Claim {
            group: "flow out of a flat-bottomed silo, over that with the usual numbers",
            name: format!("hole 8 cells across, {name}"),
            unit: "",
            reference: 1.0,
            tolerance: [0.0; 2],
            source: "neither is a property of the powder: both only have to be small, or stiff, enough",
            why: "5 %: the flow fluctuates by some per cent over the time that it is measured in",
            wrong: ["{} less flows out then", "{} more flows out then"],
            control: false,
        };
        claim.within_share(0.05)
    });
    let measure = move |seed, meter: &Meter<'_>| {
        let reference = usual.flow(law, seed, meter)?;
        others.iter().map(|other| Ok(other.flow(law, seed, meter)? / reference)).collect()
    };
    let work = usual.work(law) + others.iter().map(|other| other.work(law)).sum::<f64>();
    Case { claims: claims.into(), seeds: 1, work, measure: Box::new(measure) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    /// Down a cone that is steep and smooth enough all powder slides; on a flat bottom a part of it stays.
    #[test]
    fn a_hopper_empties_and_a_silo_does_not() {
        let law = Scene::load("bench").unwrap();
        let left = |silo: Silo| {
            let scene = silo.scene(&law);
            let [x, y, z] = silo.middle_m();
            let powder = silo.powder(&scene, 1);
            let floor_m = z - CELL_M;
            let mut rig = Rig::<f32>::new(scene, &powder).unwrap();
            rig.run(60.0 * silo.unit_s(), &Meter::unwatched()).unwrap();
            let wide = silo.shape().inner_radius_at_m(1.0).unwrap() + CELL_M;
            let left = rig.positions();
            let left =
                left.iter().filter(|p| p[2] > floor_m && libm::hypot(p[0] - x, p[1] - y) < wide).count();
            left as f64 / powder.len() as f64
        };
        let (hopper, silo) = (left(Silo::with(Outlet::Cone(30.0), 6.0, 0.0)), left(Silo::new(6.0, 0.0)));
        assert!(hopper < 0.02 && silo > 0.1, "{hopper} {silo}");
    }

    #[test]
    fn a_silo_is_a_scene_whose_powder_flows() {
        let law = Scene::load("bench").unwrap();
        let silo = Silo::new(4.0, 0.0);
        let scene = silo.scene(&law);
        assert!(scene.cfl_number() <= 0.5, "{}", scene.cfl_number());
        for silo in [silo, Silo::with(Outlet::Cone(30.0), 4.0, 0.0), Silo::with(Outlet::Slot, 4.0, 0.0)] {
            let flow = silo.flow(&law, 1, &Meter::unwatched()).unwrap();
            assert!((0.1..1.2).contains(&flow), "{silo:?}: {flow}");
        }
        // 4 mm is a twelfth of 48: by Beverloo's law 0.917 kg/s of 1000 kg/m^3 flow through that.
        let reference = Silo::new(12.0, 0.0).law(1000.0);
        assert!((reference - 0.917).abs() < 1e-3, "{reference}");
        // tan(30 deg)^-0.35.
        let steeper = Silo::with(Outlet::Cone(30.0), 12.0, 0.0).law(1000.0);
        assert!((steeper / reference - 1.212).abs() < 1e-3, "{steeper}");
        // As much as through a hole of the same hydraulic diameter, by its area: 4/pi sqrt(2) times as much for each of its squares.
        let slot = Silo::with(Outlet::Slot, 12.0, 0.0).law(1000.0);
        assert!((slot / reference / (LONG * 4.0 / PI * 2f64.sqrt()) - 1.0).abs() < 0.02, "{slot}");
    }
}
