//! Benches.

use std::path::PathBuf;

use numpy::{PyArray1, PyArray2};
use powderline_optimiser::report::amounts::Amounts;
use powderline_shared::plan::Fnv1a64;
use powderline_simulator::{
    scene::{self, EMBEDDED_SCENES},
    skill::SkillMap,
};
use pyo3::{
    prelude::*,
    types::{PyDict, PyList},
};

use crate::arrays::{self, Numbers};
use crate::{errors, json};

/// A bench: powder, tool, containers, limits of the robot and what is wanted. It is valid, and cannot be changed; `replace` gives
/// another one.
///
/// What its keys mean, with units and ranges, stands in the scene `bench`: `print(Scene.text("bench"))`.
#[pyclass(frozen, eq, module = "powderline")]
#[derive(Clone, PartialEq)]
pub(crate) struct Scene(pub(crate) scene::Scene);

#[pymethods]
impl Scene {
    /// The scene of a name (one of `Scene.names()`), or of a TOML file.
    ///
    /// Raises SceneError, which says what is wrong with the file.
    #[staticmethod]
    #[pyo3(signature = (name_or_path = PathBuf::from("bench")))]
    fn load(name_or_path: PathBuf) -> PyResult<Self> {
        scene::Scene::load(&name_or_path.to_string_lossy()).map(Self).map_err(errors::of_scene)
    }

    /// Names of the scenes that come with the package; what each is, the first lines of `Scene.text(name)` say. `bench-small` is the
    /// quickest.
    #[staticmethod]
    fn names() -> Vec<&'static str> {
        EMBEDDED_SCENES.map(|(name, _)| name).to_vec()
    }

    /// A scene that comes with the package as commented TOML, to begin from.
    #[staticmethod]
    #[pyo3(signature = (name = "bench"))]
    fn text(name: &str) -> PyResult<&'static str> {
        let known = || {
            let names = Self::names().join(", ");
            errors::SceneError::new_err(format!("there is no scene called `{name}`; known are {names}"))
        };
        scene::embedded_scene(name).ok_or_else(known)
    }

    /// A scene from a dictionary with the keys of a TOML file; a None counts as a key that is not there.
    ///
    /// Raises SceneError, which says what is wrong with it.
    #[staticmethod]
    fn from_dict(fields: &Bound<'_, PyDict>) -> PyResult<Self> {
        Self::of_fields("the dictionary", fields)
    }

    /// The fields, as `from_dict` takes them: `scene.to_dict()["powder"]["density_kg_m3"]`.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &self.0)
    }

    /// A scene from a TOML file's text.
    ///
    /// Raises SceneError, which says what is wrong with it.
    #[staticmethod]
    fn from_toml(text: &str) -> PyResult<Self> {
        scene::Scene::from_toml("the text", text).map(Self).map_err(errors::of_scene)
    }

    /// The same as TOML.
    fn to_toml(&self) -> String {
        self.0.to_toml()
    }

    /// The same bench with changes, each table given by the keys that change; the others stay. A None takes a key away. Give it a
    /// name of its own, too:
    ///
    ///     scene.replace(name="mine", powder={"friction_angle_deg": 32.0}, objective={"amount": {"mass_kg": 0.002}})
    ///
    /// Of lists of tables (`container`, `gate`) those change that are named; a list takes the place of all of them:
    ///
    ///     scene.replace(container={"target": {"friction": 0.3}})
    ///
    /// Raises SceneError, which says what is wrong with the result.
    #[pyo3(signature = (**changes))]
    fn replace(&self, py: Python<'_>, changes: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let fields = self.to_dict(py)?.cast_into::<PyDict>()?;
        if let Some(changes) = changes {
            merge(&fields, changes)?;
        }
        Self::of_fields(&format!("scene {:?}", self.0.name), &fields)
    }

    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    /// What names it in plans: 64 hexadecimal digits.
    #[getter]
    fn digest(&self) -> String {
        self.0.digest().iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// What is wanted in the target container, kilogram.
    #[getter]
    fn wanted_kg(&self) -> f64 {
        self.0.target_mass_kg()
    }

    /// Mass of a particle, kilogram.
    #[getter]
    fn particle_mass_kg(&self) -> f64 {
        self.0.particle_mass_kg()
    }

    /// Number of particles.
    #[getter]
    fn particles(&self) -> usize {
        self.0.particle_count()
    }

    /// From one control step to the next, seconds.
    #[getter]
    fn control_period_s(&self) -> f64 {
        self.0.time.control_period_s()
    }

    /// Edge of a grid cell, metres.
    #[getter]
    fn cell_m(&self) -> f64 {
        self.0.domain.cell_m
    }

    /// Extent of the simulated volume along x, y, z, which begins at the origin, metres; shape (3,).
    #[getter]
    fn size_m<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        arrays::array(py, &self.0.domain.size_m)
    }

    /// Where the tool is before the motion: x, y, z in metres, and the unit quaternion w, x, y, z; shape (7,).
    #[getter]
    fn start_pose<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        arrays::array(py, &arrays::of_pose(SkillMap::new(&self.0).start_pose()))
    }

    /// The motion of a skill: one displacement for each control step, translation in metres, then rotation vector in radians, both
    /// along the world's axes; shape (steps, 6).
    ///
    /// `theta`: depth, scooping angle, lift, transport, pouring angle, each from -1 to 1 within the scene's bounds; shape (5,).
    /// Raises SkillError.
    fn displacements<'py>(
        &self,
        py: Python<'py>,
        theta: Numbers<'py>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let theta = arrays::theta(&theta)?;
        let controls = SkillMap::new(&self.0).controls(&theta).map_err(errors::of_skill)?;
        Ok(arrays::table(py, controls.iter().map(|control| control.components()).collect()))
    }

    /// What stands behind `theta`: scooping depth (m), scooping angle (rad), lift (m), transport (m), pouring angle (rad); shape (5,).
    fn parameters<'py>(&self, py: Python<'py>, theta: Numbers<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let theta = arrays::theta(&theta)?;
        let map = SkillMap::new(&self.0);
        map.controls(&theta).map_err(errors::of_skill)?;
        Ok(arrays::array(py, &map.parameters(&theta)))
    }

    /// What a scene may be and may yet surprise: a sentence each.
    fn warnings(&self) -> Vec<String> {
        self.0.warnings()
    }

    fn __repr__(&self) -> String {
        let amounts = Amounts::from(&self.0);
        format!(
            "Scene({:?}: {} particles, {} wanted)",
            self.0.name,
            self.0.particle_count(),
            amounts.wanted()
        )
    }

    /// Of what equal scenes have in common whatever signs their zeros have.
    fn __hash__(&self) -> u64 {
        let mut hash = Fnv1a64::default();
        hash.update(self.0.name.as_bytes());
        hash.update(&(self.0.particle_count() as u64).to_le_bytes());
        hash.value()
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyAny>,))> {
        let fields = slf.get().to_dict(slf.py())?;
        Ok((slf.get_type().getattr("from_dict")?, (fields,)))
    }
}

impl Scene {
    fn of_fields(called: &str, fields: &Bound<'_, PyDict>) -> PyResult<Self> {
        if fields.is_empty() {
            let begin = "the dictionary is empty; begin from Scene.load(\"bench\").to_dict()";
            return Err(errors::SceneError::new_err(begin));
        }
        let value = json::from_python("", fields.as_any())?;
        let text = toml::to_string(&value).map_err(|error| errors::SceneError::new_err(error.to_string()))?;
        scene::Scene::from_toml(called, &text)
            .map(Self)
            .map_err(|error| errors::SceneError::new_err(error.without_line()))
    }
}

/// Puts the changes in, table by table; into a list of tables by their names.
fn merge(fields: &Bound<'_, PyDict>, changes: &Bound<'_, PyDict>) -> PyResult<()> {
    for (key, change) in changes {
        let old = fields.get_item(&key)?;
        match (old, change.cast::<PyDict>()) {
            (Some(old), Ok(change)) if old.is_instance_of::<PyDict>() && !chooses(change)? => {
                merge(old.cast::<PyDict>()?, change)?;
            }
            (Some(old), Ok(change)) if old.is_instance_of::<PyList>() => {
                merge_named(&key, old.cast::<PyList>()?, change)?;
            }
            _ => fields.set_item(key, change)?,
        }
    }
    Ok(())
}

/// A table with a `kind` is another one, not the same with other numbers.
fn chooses(change: &Bound<'_, PyDict>) -> PyResult<bool> {
    change.contains("kind")
}

fn merge_named(
    key: &Bound<'_, PyAny>,
    list: &Bound<'_, PyList>,
    changes: &Bound<'_, PyDict>,
) -> PyResult<()> {
    for (name, change) in changes {
        let (mut names, mut is_there) = (Vec::new(), false);
        for table in list {
            let table = table.cast_into::<PyDict>()?;
            let found = table.get_item("name")?;
            if found.as_ref().is_some_and(|found| found.eq(&name).unwrap_or(false)) {
                merge(&table, change.cast::<PyDict>()?)?;
                is_there = true;
                break;
            }
            names.push(found.map_or(String::new(), |found| found.to_string()));
        }
        if !is_there {
            let names = if names.is_empty() { "none".into() } else { names.join(", ") };
            return Err(errors::SceneError::new_err(format!(
                "there is no {key} called {name}; there are {names}"
            )));
        }
    }
    Ok(())
}
