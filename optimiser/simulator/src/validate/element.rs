//! One particle and the return map alone, in devices of soil mechanics: which friction angle the powder
//! mobilises.
//!
//! Stresses are those of the last of many small steps. Sides that are not held are servo-controlled to a
//! constant pressure, as by the cell of a triaxial device.

use crate::mpm::material::{Material, trial_strain};
use crate::scene::{Powder, SceneSpec};
use crate::small::{Mat3, Sym3, trace};
use crate::validate::case::{Case, Claim};
use crate::validate::rig::{YOUNGS_MODULUS, returned};

/// Pressure on the sides, Pa: that of a layer a centimetre deep.
const PRESSURE: f64 = 100.0;

/// Strain of one step, and steps: more than half of the sample's height.
const STEP: f64 = 2e-4;
const STEPS: usize = 3000;

/// How a sample is loaded along z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Device {
    /// Shortened, both sides at constant pressure.
    TriaxialCompression,
    /// Lengthened, both sides at constant pressure.
    TriaxialExtension,
    /// Shortened, one side at constant pressure, the other one held.
    PlaneStrain,
    /// Sheared in the plane of x and z, all sides held.
    SimpleShear,
}

impl Device {
    pub(super) const ALL: [Self; 4] =
        [Self::TriaxialCompression, Self::TriaxialExtension, Self::PlaneStrain, Self::SimpleShear];

    fn name(self) -> &'static str {
        match self {
            Self::TriaxialCompression => "triaxial compression",
            Self::TriaxialExtension => "triaxial extension",
            Self::PlaneStrain => "plane strain",
            Self::SimpleShear => "simple shear",
        }
    }

    /// Displacement gradient of one step, for the strains by which the sides have to give way.
    fn step(self, [x, y]: [f64; 2]) -> Mat3<f64> {
        let diagonal = |x, y, z| [[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]];
        match self {
            Self::TriaxialCompression => diagonal(x, y, -STEP),
            Self::TriaxialExtension => diagonal(x, y, STEP),
            Self::PlaneStrain => diagonal(x, 0.0, -STEP),
            Self::SimpleShear => [[0.0, 0.0, STEP], [0.0; 3], [0.0; 3]],
        }
    }
}

/// A sample of powder.
#[derive(Clone, Copy)]
pub(super) struct Sample {
    material: Material<f64>,
    bulk: f64,
    strain: Sym3<f64>,
    q: f64,
    /// Kirchhoff stress, Pa.
    stress: Sym3<f64>,
    forgets_volume: bool,
}

impl Sample {
    fn new(powder: &Powder) -> Self {
        let material = Material::of(powder);
        let bulk = powder.lame_lambda_pa() + 2.0 / 3.0 * powder.lame_mu_pa();
        Self { material, bulk, strain: [0.0; 6], q: 0.0, stress: [0.0; 6], forgets_volume: false }
    }

    fn deform(&mut self, l: &Mat3<f64>) {
        let trial = trial_strain(self.strain, l);
        (self.stress, self.strain, self.q) = returned(&self.material, trial, self.q);
        if self.forgets_volume {
            self.q = 0.0;
        }
    }

    /// By the same factor in all directions, so that the volume's logarithm grows by `growth`.
    fn expand(&mut self, growth: f64) {
        let stretch = libm::expm1(growth / 3.0);
        self.deform(&[[stretch, 0.0, 0.0], [0.0, stretch, 0.0], [0.0, 0.0, stretch]]);
    }

    /// Pressed from all sides and then loaded until it yields.
    fn loaded(mut self, device: Device) -> Self {
        self.expand(-PRESSURE / self.bulk);
        for _ in 0..STEPS {
            // In a step they make up for half of the difference.
            let give = [0, 1].map(|side| -0.5 * (self.stress[side] + PRESSURE) / self.bulk);
            self.deform(&device.step(give));
        }
        self
    }

    fn pressure(&self) -> f64 {
        -trace(self.stress) / 3.0
    }
}

/// Friction angle of Mohr's circle in the plane of x and z, rad; a quarter turn if no angle is large enough.
fn mobilised(stress: Sym3<f64>) -> f64 {
    let [x, _, z, _, xz, _] = stress;
    let radius = (0.25 * (x - z) * (x - z) + xz * xz).sqrt();
    libm::asin((radius / (-0.5 * (x + z))).clamp(0.0, 1.0))
}

/// The powder of the law with this friction angle, dry.
fn powder(law: &SceneSpec, key_deg: f64) -> Powder {
    let mut powder = law.powder.clone();
    powder.cohesion_pa = 0.0;
    powder.youngs_modulus_pa = YOUNGS_MODULUS;
    powder.friction_angle_deg = key_deg;
    powder
}

/// Degrees that a powder of this key mobilises.
pub(super) fn angle_deg(law: &SceneSpec, device: Device, key_deg: f64) -> f64 {
    mobilised(Sample::new(&powder(law, key_deg)).loaded(device).stress).to_degrees()
}

/// The same with the cone through the corners of triaxial extension.
pub(super) fn angle_of_wrong_cone_deg(law: &SceneSpec, device: Device, key_deg: f64) -> f64 {
    let mut sample = Sample::new(&powder(law, key_deg));
    let sine = libm::sin(key_deg.to_radians());
    sample.material.slope *= (3.0 - sine) / (3.0 + sine);
    mobilised(sample.loaded(device).stress).to_degrees()
}

/// By how much the volume's logarithm grows and shrinks again, and by how much it then goes on to shrink.
const EXPANSION: f64 = 0.1;
const COMPRESSION: f64 = 0.01;

/// Pressures of powder that has expanded and is back at its volume, and beyond that, each over what the
/// elastic strain between would have made.
pub(super) fn pressures_after_expansion(law: &SceneSpec, forgets_volume: bool) -> [f64; 2] {
    let mut sample = Sample { forgets_volume, ..Sample::new(&powder(law, 30.0)) };
    let by = |sample: &mut Sample, growth: f64| (0..100).for_each(|_| sample.expand(0.01 * growth));
    by(&mut sample, EXPANSION);
    by(&mut sample, -EXPANSION);
    let back = sample.pressure() / (sample.bulk * EXPANSION);
    by(&mut sample, -COMPRESSION);
    [back, sample.pressure() / (sample.bulk * COMPRESSION)]
}

/// What is claimed of one device and key.
pub(super) fn claim(device: Device, key_deg: f64) -> Claim {
    let triaxial = matches!(device, Device::TriaxialCompression | Device::TriaxialExtension);
    let (source, why) = if triaxial {
        (
            "Mohr-Coulomb: the key is the angle that a triaxial test finds",
            "0.5 deg: what a triaxial test is repeated to. In extension sands are as strong as in \
             compression, or by 2 to 4 deg stronger (Szypcio 2020, Geosciences 10, 29); Mohr-Coulomb and \
             Matsuoka-Nakai have the same angle in both",
        )
    } else {
        (
            "Mohr-Coulomb, with the excess of sands in plane strain: Matsuoka and Nakai 1974, Proc. JSCE \
             232; Lade and Duncan 1975, J. Geotech. Eng. Div. 101",
            "4 deg: by up to so much sands are stronger in plane strain than in triaxial compression",
        )
    };
    let claim = Claim {
        group: "friction angle of one particle",
        name: format!("{}, key {key_deg} deg", device.name()),
        unit: "deg",
        reference: key_deg,
        tolerance: [0.0; 2],
        source,
        why,
        wrong: ["The powder is weaker than its key by {}", "The powder is stronger than its key by {}"],
        control: false,
    };
    claim.within(if triaxial { 0.5 } else { 4.0 })
}

/// What is claimed of volume that was lost to expansion.
pub(super) fn claims_of_volume() -> [Claim; 2] {
    let claim = |name: &str, reference, wrong| {
        let claim = Claim {
            group: "volume of one particle after an expansion",
            name: name.into(),
            unit: "",
            reference,
            tolerance: [0.0; 2],
            source: "loose powder bears nothing, and bears again where its grains meet",
            why: "0.02: a return map of a hundred steps has no reason to forget more",
            wrong,
            control: false,
        };
        claim.within(0.02)
    };
    [
        claim(
            "pressure back at the volume of before",
            0.0,
            [
                "The powder pulls by {} of the elastic pressure",
                "The powder pushes too early, by {} of the pressure",
            ],
        ),
        claim(
            "pressure when squeezed beyond that",
            1.0,
            [
                "The powder has lost volume: it bears {} less",
                "The powder has gained volume: it bears {} more",
            ],
        ),
    ]
}

/// Friction angles, degrees.
pub(super) const KEYS: [f64; 6] = [20.0, 25.0, 30.0, 35.0, 40.0, 45.0];

/// All of it; it takes no time.
pub(super) fn cases(law: &SceneSpec) -> Vec<Case<'_>> {
    let angles = Device::ALL.map(|device| Case {
        claims: KEYS.map(|key| claim(device, key)).into(),
        seeds: 1,
        work: 0.0,
        measure: Box::new(move |_, _| Ok(KEYS.map(|key| angle_deg(law, device, key)).into())),
    });
    let volume = Case {
        claims: claims_of_volume().into(),
        seeds: 1,
        work: 0.0,
        measure: Box::new(|_, _| Ok(pressures_after_expansion(law, false).into())),
    };
    angles.into_iter().chain([volume]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{DEFAULT_SCENE, Scene};

    #[test]
    fn mohrs_circle_gives_the_angle_of_its_tangent() {
        // sin(30 deg) = 1/2: principal stresses of 3 and 1, whichever way they point.
        for stress in [
            [-1.0, -9.0, -3.0, 0.0, 0.0, 0.0],
            [-3.0, 0.0, -1.0, 0.0, 0.0, 0.0],
            [-2.0, -5.0, -2.0, 0.0, 1.0, 0.0],
        ] {
            assert!((mobilised(stress).to_degrees() - 30.0).abs() < 1e-9, "{stress:?}");
        }
        assert!((mobilised([1.0, 0.0, -3.0, 0.0, 0.0, 0.0]).to_degrees() - 90.0).abs() < 1e-9);
    }

    #[test]
    fn devices_hold_their_sides_at_the_pressure_and_have_come_to_yield() {
        let law = Scene::load(DEFAULT_SCENE).unwrap();
        for device in Device::ALL {
            let sample = Sample::new(&powder(&law, 25.0)).loaded(device);
            let held = match device {
                Device::TriaxialCompression | Device::TriaxialExtension => &sample.stress[..2],
                Device::PlaneStrain => &sample.stress[..1],
                Device::SimpleShear => &[],
            };
            assert!(held.iter().all(|side| (side / PRESSURE + 1.0).abs() < 0.2), "{device:?} {held:?}");
            let [now, before] = [0, STEPS / 4].map(|fewer| {
                let mut sample = Sample::new(&powder(&law, 25.0));
                sample.expand(-PRESSURE / sample.bulk);
                for _ in 0..STEPS - fewer {
                    let give = [0, 1].map(|side| -0.5 * (sample.stress[side] + PRESSURE) / sample.bulk);
                    sample.deform(&device.step(give));
                }
                mobilised(sample.stress).to_degrees()
            });
            assert!((now - before).abs() < 0.02, "{device:?}: {before} and later {now} deg");
            assert!((now - mobilised(sample.stress).to_degrees()).abs() < 1e-9);
        }
    }

    #[test]
    fn a_sample_is_squeezed_elastically_by_the_pressure() {
        let law = Scene::load(DEFAULT_SCENE).unwrap();
        let mut sample = Sample::new(&powder(&law, 25.0));
        sample.expand(-PRESSURE / sample.bulk);
        assert!((sample.pressure() / PRESSURE - 1.0).abs() < 1e-9, "{}", sample.pressure());
    }
}
