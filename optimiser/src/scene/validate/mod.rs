//! Whether a scene makes sense; the first thing wrong is reported as one sentence.

use super::{MAX_CFL, Scene, SceneError};

impl Scene {
    /// Checks every field's range and the rules between fields. `file` stands for the scene in messages.
    ///
    /// # Errors
    /// [`SceneError::Invalid`] with the field, its value and what would be right.
    pub fn validate(&self, file: &str) -> Result<(), SceneError> {
        let cfl = self.cfl_number();
        // Not `cfl > MAX_CFL`: a NaN must be refused.
        if cfl <= MAX_CFL {
            return Ok(());
        }
        Err(SceneError::Invalid {
            file: file.to_owned(),
            field: "powder.youngs_modulus_pa".to_owned(),
            value: self.powder.youngs_modulus_pa.to_string(),
            expected: format!("the CFL number is {cfl} and must be at most {MAX_CFL}"),
        })
    }
}
