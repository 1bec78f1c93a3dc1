//! Whether a scene makes sense; the first thing wrong is reported as one sentence.

mod checker;
mod fields;
mod gates;
mod layout;
mod reach;

use super::{Container, Scene, SceneError};
use checker::Checker;

impl Scene {
    /// Checks every field's range and the rules between fields; the first thing wrong is returned.
    /// `file` stands for the scene in messages.
    ///
    /// The rules between fields, in this order: cells and particles within [`super::MAX_CELLS`] and
    /// [`super::MAX_PARTICLES`]; substeps of a rollout within [`super::MAX_SUBSTEPS`]; CFL number
    /// and viscous loss; cohesion needs friction; containers within the domain and clear of each
    /// other, names unique; source and target among them, the target point within the domain, no
    /// more wanted than there is; the powder clear of walls and floors; gates, their names unique, within
    /// the domain and clear of the powder while they are shut, none too fast; the tool at its start
    /// within domain and workspace, clear of containers, shut gates and powder, its deepest scoop
    /// above the source's floor;
    /// every skill within domain and workspace, its longest within the horizon, its speeds within
    /// the limits.
    ///
    /// # Errors
    /// [`SceneError::Invalid`] with the field, its value and what would be right.
    pub fn validate(&self, file: &str) -> Result<(), SceneError> {
        let checker = Checker { file };
        // Each check may rely on those before it.
        fields::check(&checker, self)?;
        layout::check_size(&checker, self)?;
        layout::check_substeps(&checker, self)?;
        layout::check_cfl(&checker, self)?;
        layout::check_powder_law(&checker, self)?;
        layout::check_containers(&checker, self)?;
        layout::check_objective(&checker, self)?;
        layout::check_powder(&checker, self)?;
        gates::check(&checker, self)?;
        layout::check_start(&checker, self)?;
        reach::check(&checker, self)
    }

    /// The container that the tool scoops from, and that the powder starts in as a rule.
    ///
    /// # Panics
    /// If the scene was not validated and names no such container.
    pub fn source(&self) -> &Container {
        self.container_named(&self.objective.source)
    }

    /// The container that the powder should go to.
    ///
    /// # Panics
    /// If the scene was not validated and names no such container.
    pub fn target(&self) -> &Container {
        self.container_named(&self.objective.target)
    }

    fn container_named(&self, name: &str) -> &Container {
        self.containers
            .iter()
            .find(|container| container.name == name)
            .expect("a validated scene has its source and its target")
    }
}
