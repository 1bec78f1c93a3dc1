//! The sentences of the Rust crates as Python's exceptions.

use std::io::ErrorKind;

use powderline_optimiser::cli::CliError;
use powderline_shared::plan::file::{LoadCause, LoadError};
use powderline_simulator::{rollout::RolloutError, scene, skill};
use pyo3::{
    create_exception,
    exceptions::{PyFileNotFoundError, PyKeyboardInterrupt, PyRuntimeError, PyValueError},
    prelude::*,
};

create_exception!(
    powderline,
    SceneError,
    PyValueError,
    "A scene that makes no sense: names the field, its value and what would be right."
);
create_exception!(
    powderline,
    SkillError,
    PyValueError,
    "A skill that is no motion, or not one that the arm may make."
);
create_exception!(
    powderline,
    PlanError,
    PyValueError,
    "A file that is no plan, or a motion that can be none."
);
create_exception!(powderline, SimulationError, PyRuntimeError, "A simulation that came to no end.");
create_exception!(
    powderline,
    MotionError,
    SimulationError,
    "A motion from which powder leaves the simulated volume, or whose numbers are no longer finite; another one may come to its end."
);

pub(crate) fn of_scene(error: scene::SceneError) -> PyErr {
    SceneError::new_err(error.to_string())
}

pub(crate) fn of_skill(error: skill::SkillError) -> PyErr {
    SkillError::new_err(error.to_string())
}

pub(crate) fn of_theta(error: skill::ThetaError) -> PyErr {
    SkillError::new_err(error.to_string())
}

pub(crate) fn of_rollout(error: RolloutError) -> PyErr {
    match error {
        RolloutError::Skill(error) => of_skill(error),
        RolloutError::Theta(error) => of_theta(error),
        RolloutError::Stopped => PyKeyboardInterrupt::new_err(error.to_string()),
        RolloutError::Memory { .. } | RolloutError::Threads { .. } => {
            PyValueError::new_err(error.to_string())
        }
        error if error.is_of_motion() => MotionError::new_err(error.to_string()),
        error => SimulationError::new_err(error.to_string()),
    }
}

pub(crate) fn of_file(error: LoadError) -> PyErr {
    match error.cause() {
        LoadCause::Io(cause) if cause.kind() == ErrorKind::NotFound => {
            PyFileNotFoundError::new_err(error.to_string())
        }
        _ => PlanError::new_err(error.to_string()),
    }
}

pub(crate) fn of_command(error: CliError) -> PyErr {
    match error {
        CliError::Input(text) => PyValueError::new_err(text),
        CliError::Interrupted(text) => PyKeyboardInterrupt::new_err(text),
        error => SimulationError::new_err(error.to_string()),
    }
}
