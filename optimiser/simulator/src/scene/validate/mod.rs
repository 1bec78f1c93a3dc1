//! Whether a scene makes sense; what is wrong is said in one sentence each.

mod checker;
mod fields;
mod found;
mod gates;
mod layout;
mod reach;

use super::error::is_name;
use super::{Container, Scene, SceneError, SceneSpec};
use checker::Checker;

pub(super) use checker::{Range, TURN_DEG};
pub(super) use found::Found;

impl SceneSpec {
    /// The scene, if every field is in its range and all of them agree. Messages call it by its name.
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
    /// [`SceneError::Invalid`]: all fields that are out of range, each with its value and what would be right; where there are none,
    /// the first of these rules that is broken, and of substeps, CFL number, viscous loss and cohesion all.
    pub fn validate(self) -> Result<Scene, SceneError> {
        let file =
            if is_name(&self.name) { format!("scene {:?}", self.name) } else { "the scene".to_owned() };
        self.validate_as(&file)
    }

    /// The same with another word for the scene in messages, such as the path of its file.
    ///
    /// # Errors
    /// As [`Self::validate`].
    pub fn validate_as(self, file: &str) -> Result<Scene, SceneError> {
        let scene = Scene(self);
        let checker = Checker { file };
        all_right(fields::check(&checker, &scene))?;
        // Each of these may rely on those before it.
        layout::check_size(&checker, &scene)?;
        let alone = [layout::check_substeps, layout::check_cfl, layout::check_powder_law];
        all_right(alone.iter().filter_map(|check| check(&checker, &scene).err()).collect())?;
        layout::check_containers(&checker, &scene)?;
        layout::check_objective(&checker, &scene)?;
        layout::check_powder(&checker, &scene)?;
        gates::check(&checker, &scene)?;
        layout::check_start(&checker, &scene)?;
        reach::check(&checker, &scene)?;
        Ok(scene)
    }
}

fn all_right(mut errors: Vec<SceneError>) -> Result<(), SceneError> {
    match errors.len() {
        0 => Ok(()),
        1 => Err(errors.remove(0)),
        _ => Err(SceneError::Several(errors)),
    }
}

impl Scene {
    /// The container that the tool scoops from, and that the powder starts in as a rule.
    pub fn source(&self) -> &Container {
        self.container_named(&self.objective.source)
    }

    /// The container that the powder should go to.
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
