//! A scene that is known to be valid.

use std::ops::Deref;

use serde::Serialize;

use super::{SceneError, SceneSpec};

/// A valid [`SceneSpec`], read-only: what takes one needs not look again, and cannot be given anything else.
///
/// ```compile_fail
/// # use powderline_simulator::scene::Scene;
/// let mut scene = Scene::load("bench")?;
/// scene.powder.density_kg_m3 = -1.0; // error[E0594]: cannot assign to data in dereference of `Scene`
/// # Ok::<(), powderline_simulator::scene::SceneError>(())
/// ```
///
/// What was not looked at is simulated by nobody:
///
/// ```compile_fail
/// # use powderline_simulator::rollout::{Simulator, SimulatorSettings};
/// # use powderline_simulator::scene::Scene;
/// let mut spec = Scene::load("bench")?.into_spec();
/// spec.powder.density_kg_m3 = -1.0;
/// Simulator::<f32>::new(&spec, &SimulatorSettings::default())?; // error[E0308]: expected `&Scene`, found `&SceneSpec`
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// ```
/// # use powderline_simulator::scene::Scene;
/// let scene = Scene::load("bench")?;
/// let smoother = scene.with(|spec| spec.powder.friction_angle_deg = 32.0)?;
/// let refused = scene.with(|spec| spec.powder.density_kg_m3 = -1.0).unwrap_err();
/// assert_eq!(
///     refused.to_string(),
///     "scene \"bench\": powder.density_kg_m3 is -1, but it must be from 10 to 25000"
/// );
/// # Ok::<(), powderline_simulator::scene::SceneError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Scene(pub(super) SceneSpec);

impl Scene {
    /// The same bench with changes, which all have to be right together.
    ///
    /// # Errors
    /// As [`SceneSpec::validate`].
    pub fn with(&self, change: impl FnOnce(&mut SceneSpec)) -> Result<Self, SceneError> {
        let mut spec = self.0.clone();
        change(&mut spec);
        spec.validate()
    }

    /// Its fields, to be changed.
    pub fn into_spec(self) -> SceneSpec {
        self.0
    }
}

impl SceneSpec {
    /// For apparatus of the crate's own, in which no skill is performed: without source, target or tool to speak of.
    pub(crate) fn unchecked(self) -> Scene {
        Scene(self)
    }
}

impl Deref for Scene {
    type Target = SceneSpec;

    fn deref(&self) -> &SceneSpec {
        &self.0
    }
}

/// The crate's own tests break scenes on purpose.
#[cfg(test)]
impl std::ops::DerefMut for Scene {
    fn deref_mut(&mut self) -> &mut SceneSpec {
        &mut self.0
    }
}
