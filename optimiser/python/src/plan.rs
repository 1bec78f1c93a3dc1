//! Plans.

use std::{
    io::Write,
    path::{Path, PathBuf},
};

use numpy::{PyArray1, PyArray2};
use powderline_optimiser::{
    cli::{embedded_scene_of_plan, scene_of_plan},
    report::{amounts::Amounts, finding::Outcome, plan::PlanParts},
};
use powderline_shared::{
    displacement::{Displacement, pose_at},
    plan::{
        Fnv1a64, Mounting, PlanHeader, PlanReader, Precision, Prediction, SkillParameter,
        file::{check_plan, read_plan_file},
    },
    pose::Pose,
};
use powderline_simulator::{
    arm::{self, ArmMotion, CYCLE_US, Mount, Surroundings, ToolPath},
    rollout, scene,
    scene::figures::mass,
    skill::{QuantisedControls, SkillMap, Theta, collision, controls_of},
};
use powderline_view::whole::Whole;
use pyo3::{exceptions::PyOSError, prelude::*, types::PyDict};

use crate::arrays;
use crate::errors::{self, PlanError};
use crate::evaluation::arrival;
use crate::json;
use crate::scene::Scene;

/// A motion for an arm, as `execute` plays it: made by `optimise` or `Simulator.plan`.
#[pyclass(frozen, module = "powderline")]
pub(crate) struct Plan {
    bytes: Vec<u8>,
    header: PlanHeader,
    /// After each control step, the start first.
    poses: Vec<Pose>,
    controls: Vec<Displacement>,
    /// The bench that it was made for, where that is known.
    scene: Option<scene::Scene>,
}

/// What makes a plan again, and of what.
type Pickled<'py> = (Bound<'py, PyAny>, (Vec<u8>, Option<Scene>));

#[pymethods]
impl Plan {
    /// Reads a plan file; its bytes, its numbers and its limits are checked.
    ///
    /// Raises FileNotFoundError; PlanError, which says what is wrong with it.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        let bytes = read_plan_file(&path).map_err(errors::of_file)?;
        let plan = check_plan(&path, &bytes).map_err(errors::of_file)?;
        let scene = scene_of_plan(&path, plan.header());
        Ok(Self::new(&plan, &bytes, scene))
    }

    /// Writes the plan to a file, whose folder is made; the same plan is the same bytes. `load` knows the scene again if that comes with the package, or
    /// stands beside the file: `Path("scene.toml").write_text(scene.to_toml())`.
    ///
    /// Raises OSError.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        // A plan that was there stays until this one is whole.
        let write = || {
            let file = Whole::new(&path)?;
            file.file().write_all(&self.bytes).map_err(|error| file.error(error))?;
            file.commit()
        };
        write().map_err(|error| PyOSError::new_err(error.to_string()))
    }

    /// A plan from a file's bytes, and the scene that it was made for, if that is known; one that comes with the package is.
    ///
    /// Raises PlanError, which says what is wrong with it, or that it was made for another scene.
    #[staticmethod]
    #[pyo3(signature = (bytes, scene = None))]
    fn from_bytes(bytes: &[u8], scene: Option<&Bound<'_, Scene>>) -> PyResult<Self> {
        let plan = check_plan(Path::new("the plan"), bytes).map_err(errors::of_file)?;
        let scene = match scene.map(|scene| scene.get().0.clone()) {
            None => embedded_scene_of_plan(plan.header()),
            Some(scene) => {
                check_scene(&scene, plan.header())?;
                Some(scene)
            }
        };
        Ok(Self::new(&plan, bytes, scene))
    }

    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        other.cast::<Self>().is_ok_and(|other| other.get().bytes == self.bytes)
    }

    fn __hash__(&self) -> u64 {
        let mut hash = Fnv1a64::default();
        hash.update(&self.bytes);
        hash.value()
    }

    /// The file's bytes.
    fn to_bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The skill, each parameter from -1 to 1; shape (5,).
    #[getter]
    fn theta<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        arrays::array(py, &self.header.theta)
    }

    /// The same in metres and radians, by name: scooping_depth_m, scooping_angle_rad, lift_height_m, transport_displacement_m,
    /// pouring_angle_rad.
    #[getter]
    fn parameters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let parameters = PyDict::new(py);
        for parameter in SkillParameter::ALL {
            let name = format!("{}_{}", parameter.name().replace(' ', "_"), parameter.unit());
            parameters.set_item(name, self.header.skill_parameters[parameter.index()])?;
        }
        Ok(parameters)
    }

    /// How many numbers say how the motion leaves the skill's: 0 where it is the skill's own.
    #[getter]
    fn path_coefficients(&self) -> u32 {
        self.header.path_coefficients
    }

    /// Edge of the cells smaller than the scene's on which the plan was looked at, and perhaps corrected, metres; None if it was not.
    /// Mass, miss and the like are those there.
    #[getter]
    fn finer_cell_m(&self) -> Option<f64> {
        self.header.finer.map(|finer| finer.cell_m)
    }

    /// What it brings on the scene's own cells, kilogram.
    #[getter]
    fn own_mass_kg(&self) -> f64 {
        self.header.predicted.arrives_kg()
    }

    /// Particles by where they are at the end, on the scene's own cells: source, target, rims, tool, spilled, in_flight.
    #[getter]
    fn census<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        json::to_python(py, &self.header.predicted.census)
    }

    /// "f32" or "f64": of the simulation that it was made by, as a Simulator is to have it that is to find the same.
    #[getter]
    fn precision(&self) -> &'static str {
        self.header.precision.name()
    }

    /// Seed of the packing that it was made with.
    #[getter]
    fn seed(&self) -> u64 {
        self.header.seed
    }

    /// From one control step to the next, seconds.
    #[getter]
    fn control_period_s(&self) -> f64 {
        f64::from(self.header.control_period_us) * 1e-6
    }

    /// Displacements in whole counts, one for each control step, as `Simulator.motion` takes them; shape (steps, 6).
    #[getter]
    fn displacements<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        arrays::table(py, self.controls.iter().map(Displacement::components).collect())
    }

    /// The tool at the beginning and after each control step: x, y, z in metres, and the unit quaternion w, x, y, z; shape
    /// (steps + 1, 7).
    #[getter]
    fn poses<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        arrays::table(py, self.poses.iter().map(arrays::of_pose).collect())
    }

    /// When `poses` are, seconds; shape (steps + 1,).
    #[getter]
    fn times_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let times: Vec<f64> = (0..self.poses.len() as u64)
            .map(|tick| (tick * u64::from(self.header.control_period_us)) as f64 / 1e6)
            .collect();
        arrays::array(py, &times)
    }

    /// What it brings, simulated as shipped, on the smallest cells on which it was looked at, kilogram.
    #[getter]
    fn mass_kg(&self) -> f64 {
        self.outcome().mass_kg
    }

    /// What was wanted, kilogram.
    #[getter]
    fn wanted_kg(&self) -> f64 {
        self.header.predicted.wanted_kg
    }

    /// How far `mass_kg` is off `wanted_kg`, relative: negative where powder is missing.
    #[getter]
    fn miss(&self) -> f64 {
        self.outcome().miss
    }

    /// Whether the miss is within the scene's tolerance; None where the scene is not known, or as much as can be had is wanted.
    #[getter]
    fn met(&self) -> Option<bool> {
        self.amounts().is_met(self.outcome().census.target)
    }

    /// What is on rims, spilled or in flight at the end, kilogram.
    #[getter]
    fn lost_kg(&self) -> f64 {
        self.outcome().lost_kg
    }

    /// Loss of the motion as shipped, on the scene's own cells, metres: in whole counts (of 100 nm and 100 nrad), which move it a little.
    #[getter]
    fn loss(&self) -> f64 {
        self.header.predicted.loss_m
    }

    /// The arm that can make it; None if nobody looked.
    #[getter]
    fn arm(&self) -> Option<&'static str> {
        self.header.arm.map(|arm| arm.kind.name())
    }

    /// The scene that it was made for, if that stood as scene.toml beside the file or comes with the package.
    #[getter]
    fn scene(&self) -> Option<Scene> {
        self.scene.clone().map(Scene)
    }

    /// Joint angles of the plan's arm at each of `times_s`, radians, from the base to the flange (base, shoulder, elbow, wrist 1, 2, 3);
    /// shape (steps + 1, 6).
    ///
    /// scene: what the arm is kept clear of, if `self.scene` is None. Raises PlanError where there is no arm, or where it cannot make
    /// the motion.
    #[pyo3(signature = (*, scene = None))]
    fn to_joint_angles<'py>(
        &self,
        py: Python<'py>,
        scene: Option<&Bound<'py, Scene>>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let scene = match scene {
            Some(given) => &given.get().0,
            None => self.scene.as_ref().ok_or_else(|| {
                PlanError::new_err("the plan's scene is not known: give the one that it was made for as scene=.., or write it as scene.toml beside the plan's file")
            })?,
        };
        check_scene(scene, &self.header)?;
        let joints = py.detach(|| self.joints(scene)).map_err(PlanError::new_err)?;
        Ok(arrays::table(py, joints))
    }

    fn __repr__(&self) -> String {
        format!(
            "Plan({}{}, {:.2} s{})",
            if self.met() == Some(false) { "misses: " } else { "" },
            arrival(&self.amounts(), &self.outcome()),
            self.controls.len() as f64 * self.control_period_s(),
            self.arm().map_or(String::new(), |arm| format!(", {arm}"))
        )
    }

    /// What a notebook shows.
    fn _repr_html_(&self) -> String {
        let row = |name: &str, value: String| {
            format!("<tr><th style=\"text-align:left\">{name}</th><td>{value}</td></tr>")
        };
        let mut rows = vec![
            row("arrives", self.arrives_in_words()),
            row("on the scene's own cells", mass(self.own_mass_kg())),
            row("lost", mass(self.lost_kg())),
            row("loss", format!("{:.3} m", self.loss())),
            row("lasts", format!("{:.2} s", self.controls.len() as f64 * self.control_period_s())),
        ];
        for parameter in SkillParameter::ALL {
            let value = self.header.skill_parameters[parameter.index()];
            let words = if parameter.is_angle() {
                format!("{:.1} deg", value.to_degrees())
            } else {
                format!("{:.2} mm", 1e3 * value)
            };
            rows.push(row(parameter.name(), words));
        }
        rows.push(row("arm", self.arm().unwrap_or("none looked at").into()));
        format!("<table>{}</table>", rows.concat())
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<Pickled<'py>> {
        let plan = slf.get();
        Ok((slf.get_type().getattr("from_bytes")?, (plan.bytes.clone(), plan.scene())))
    }
}

impl Plan {
    fn new(plan: &PlanReader<'_>, bytes: &[u8], scene: Option<scene::Scene>) -> Self {
        let header = *plan.header();
        let start = header.start_pose();
        let setpoints: Vec<_> = plan.setpoints().collect();
        let after = setpoints.iter().map(|setpoint| pose_at(&start, *setpoint, header.lsb));
        Self {
            bytes: bytes.to_vec(),
            poses: std::iter::once(start).chain(after).collect(),
            controls: controls_of(&setpoints, header.lsb),
            header,
            scene,
        }
    }

    fn of_bytes(bytes: &[u8], scene: Option<scene::Scene>) -> PyResult<Self> {
        let plan = check_plan(Path::new("the plan"), bytes).map_err(errors::of_file)?;
        Ok(Self::new(&plan, bytes, scene))
    }

    fn amounts(&self) -> Amounts {
        self.finest().0
    }

    fn outcome(&self) -> Outcome {
        self.finest().1
    }

    /// What is wanted, and what counts as that, where the scene is known; and what it brings, on the smallest cells on which it was looked at.
    fn finest(&self) -> (Amounts, Outcome) {
        let Prediction { wanted_kg, indicator, particle_mass_kg, census, .. } = self.header.predicted;
        let wanted_particles = (indicator + i64::from(census.target)).max(0) as u32;
        let tolerance = self.scene.as_ref().and_then(|scene| Amounts::from(scene).tolerance);
        let own = Amounts { wanted_kg, wanted_particles, tolerance, particle_mass_kg };
        Outcome::finest_of_plan(&own, &self.header)
    }

    /// A miss first.
    fn arrives_in_words(&self) -> String {
        let (amounts, outcome) = self.finest();
        let target = outcome.census.target;
        let arrival = format!(
            "{} of {} wanted: {}",
            amounts.mass(target),
            mass(amounts.wanted_kg),
            amounts.off(target)
        );
        match self.met() {
            Some(true) => format!("{arrival}, within the tolerance of {}", amounts.tolerance()),
            Some(false) => {
                format!("<b>misses</b>: {arrival}, more than the tolerance of {}", amounts.tolerance())
            }
            None => arrival,
        }
    }

    /// Joints at each tick, radians.
    fn joints(&self, scene: &scene::Scene) -> Result<Vec<[f64; 6]>, String> {
        let PlanHeader { arm, control_period_us, lsb, limits, .. } = self.header;
        let arm = arm.ok_or("the plan has no arm: the scene it was made for has no [arm]")?;
        let of_scene = scene.arm.as_ref();
        let mount = Mount::of_plan(&arm, of_scene.map(|arm| arm.clearance_m));
        let path = ToolPath { period_us: control_period_us, lsb, limits, poses: self.poses.clone() };
        let table_m = of_scene.map_or(f64::NEG_INFINITY, |arm| arm.table_height_m);
        let around = Surroundings::of_scene(scene, table_m);
        let made = ArmMotion::new(&path, &mount, &around, CYCLE_US).map_err(|refusal| refusal.to_string())?;
        Ok(made.joints)
    }
}

/// Whether a plan was made for this scene.
fn check_scene(scene: &scene::Scene, header: &PlanHeader) -> PyResult<()> {
    if scene.digest() == header.scene_digest {
        return Ok(());
    }
    let [wanted, found] = [header.scene_digest, scene.digest()]
        .map(|digest| digest[..4].iter().map(|byte| format!("{byte:02x}")).collect::<String>());
    Err(PlanError::new_err(format!(
        "the plan was made for a scene of digest {wanted}.., but {:?} has {found}..: give the very one, with its changes",
        scene.name
    )))
}

/// A plan that is checked, but not simulated yet.
pub(crate) struct Unevaluated {
    theta: Theta,
    map: SkillMap,
    quantised: QuantisedControls,
    arm: Option<Mounting>,
}

impl Unevaluated {
    pub(crate) fn new(scene: &scene::Scene, theta: &Theta) -> PyResult<Self> {
        let map = SkillMap::new(scene);
        let quantised = map.quantise(theta).map_err(errors::of_skill)?;
        map.check_limits(&quantised).map_err(errors::of_skill)?;
        if let Some(collision) = collision(scene, map.start_pose(), &quantised.controls) {
            return Err(errors::SkillError::new_err(collision.to_string()));
        }
        let arm = arm::arm_motion(scene, &map, &quantised).map_err(|refusal| {
            PlanError::new_err(format!("the arm cannot make the plan's motion: {refusal}"))
        })?;
        let arm = arm.as_ref().map(|arm| Mounting::from(&arm.model));
        Ok(Self { theta: *theta, map, quantised, arm })
    }

    pub(crate) fn controls(&self) -> &[Displacement] {
        &self.quantised.controls
    }

    pub(crate) fn plan(
        &self,
        scene: &scene::Scene,
        seed: u64,
        precision: Precision,
        evaluation: &rollout::Evaluation,
    ) -> PyResult<Plan> {
        let Self { theta, map, quantised, arm } = self;
        let parts = PlanParts {
            scene,
            map,
            seed,
            precision,
            theta,
            path_coefficients: 0,
            quantised,
            evaluation,
            finer: None,
            arm: *arm,
        };
        let bytes =
            parts.to_bytes().map_err(|error| PlanError::new_err(format!("no plan can be made: {error}")))?;
        Plan::of_bytes(&bytes, Some(scene.clone()))
    }
}
