//! The simulator of one scene.

use std::ops::ControlFlow;
use std::sync::Mutex;

use numpy::{PyArray1, PyArray2, PyReadonlyArray2};
use powderline_optimiser::cli::{MAX_THREADS, format_size, parse_size};
use powderline_shared::{displacement::Displacement, plan::Precision, pose::Pose};
use powderline_simulator::{
    rollout::{
        self, AnySimulator, DisplacementGradient, Recording, RolloutError, Simulate, SimulatorSettings,
        Snapshot, Workload, part, restart::Restarts,
    },
    scene,
    skill::{SkillMap, SkillParameter, Theta, ThetaGradient},
};
use pyo3::{
    PyTraverseError, PyVisit,
    exceptions::{PyMemoryError, PyRuntimeError, PyTypeError, PyValueError},
    prelude::*,
    types::PyTuple,
};

use crate::arrays::{self, Numbers, Table};
use crate::episode::Episode;
use crate::evaluation::Evaluation;
use crate::motion::Motion;
use crate::plan::Plan;
use crate::scene::Scene;
use crate::watched::{Link, simulated};
use crate::{errors, given, plan};

/// How a gradient is computed.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Adjoint,
    Restarted,
    Differences,
}

impl Kind {
    const ALL: [(&'static str, Self); 3] =
        [("adjoint", Self::Adjoint), ("restarted", Self::Restarted), ("differences", Self::Differences)];
}

/// Simulates motions of a scene's tool, and what the powder makes of them.
///
/// seed: of the packing; the scene's `powder.seed` if None, as in `optimise`. precision: "f32" or "f64". threads: as many as the machine has
/// processors, if None. memory: the most that the process may take in gradients, such as "2GiB" or a number of bytes, which is refused
/// where it does not hold one; about "1GiB" if None. What other packages take in the process counts, and where it leaves little, a
/// gradient takes longer.
/// progress: called with the share of the present call that is done, from 0 to 1, now and then, and with 1 at its end; what it raises
/// ends the call. Neither threads nor memory change a bit of any result.
///
/// Calls release Python's lock; Ctrl-C ends them. A simulator does one thing at a time: threads need one each, and so do processes, a
/// forked one, too; pickled, it is made anew where it arrives, without `progress`.
///
/// What is wrong with what is given raises ValueError or SkillError, a motion that comes to no end MotionError, powder that does not settle
/// SimulationError, and a simulator that is at work already RuntimeError.
#[pyclass(frozen, module = "powderline")]
pub(crate) struct Simulator {
    /// The bench.
    #[pyo3(get)]
    scene: Py<Scene>,
    /// Seed of the packing.
    #[pyo3(get)]
    seed: u64,
    precision: Precision,
    settings: SimulatorSettings,
    /// Whether somebody has said how much memory there is.
    is_bounded: bool,
    progress: Option<Py<PyAny>>,
    inner: Mutex<AnySimulator>,
    /// The process that its threads are of.
    process: u32,
}

/// What makes a simulator again, and of what.
type Pickled<'py> = (Bound<'py, PyAny>, (Py<Scene>, u64, &'static str, Option<usize>, Option<u64>));

/// Skills that are looked at side by side, of many, for each thread: each takes memory as long as it is.
const SKILLS_PER_THREAD: usize = 8;

/// A seed.
pub(crate) fn checked_seed(seed: &Bound<'_, PyAny>) -> PyResult<u64> {
    given::whole("seed", seed, 0..=i128::from(u64::MAX), "from 0 to 2^64 - 1")
}

/// A number format by its name.
pub(crate) fn checked_precision(name: &Bound<'_, PyAny>) -> PyResult<Precision> {
    given::word("precision", name, &Precision::ALL.map(|precision| (precision.name(), precision)))
}

/// As many threads as the programs take, too.
pub(crate) fn checked_threads(threads: &Bound<'_, PyAny>) -> PyResult<u16> {
    let right = format!("from 1 to {MAX_THREADS}, or None");
    given::whole("threads", threads, 1..=i128::from(MAX_THREADS), &right)
}

/// As much memory as is said: a size in words, or bytes.
pub(crate) fn memory_bytes(memory: &Bound<'_, PyAny>) -> PyResult<u64> {
    match memory.extract::<String>() {
        Ok(text) => parse_size(&text).map_err(|error| PyValueError::new_err(format!("memory: {error}"))),
        Err(_) => memory.extract().map_err(|_| {
            PyValueError::new_err(format!(
                "memory is {}, but it must be a size such as \"2GiB\", or a whole number of bytes",
                given::shown(memory)
            ))
        }),
    }
}

/// Threads and memory that a program of its own is to have: the threads, and bytes.
#[pyfunction]
pub(crate) fn checked_resources(
    threads: &Bound<'_, PyAny>,
    memory: &Bound<'_, PyAny>,
) -> PyResult<(u16, u64)> {
    Ok((checked_threads(threads)?, memory_bytes(memory)?))
}

#[pymethods]
impl Simulator {
    #[new]
    #[pyo3(
        signature = (scene, *others, seed = None, precision = None, threads = None, memory = None, progress = None),
        text_signature = "(scene, *, seed=None, precision='f32', threads=None, memory=None, progress=None)"
    )]
    fn new(
        scene: Bound<'_, Scene>,
        others: &Bound<'_, PyTuple>,
        seed: Option<&Bound<'_, PyAny>>,
        precision: Option<&Bound<'_, PyAny>>,
        threads: Option<&Bound<'_, PyAny>>,
        memory: Option<&Bound<'_, PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        given::by_name(others, "Simulator(scene, seed=1)")?;
        let usual = SimulatorSettings::default();
        let seed = seed.map_or(Ok(scene.get().0.powder.seed), checked_seed)?;
        let threads = threads.map(checked_threads).transpose()?.map(usize::from);
        if let Some(progress) =
            progress.as_ref().map(|progress| progress.bind(scene.py())).filter(|p| !p.is_callable())
        {
            let given = progress.repr()?;
            return Err(PyTypeError::new_err(format!(
                "progress is {given}, but it must be a function, or None"
            )));
        }
        let is_bounded = memory.is_some();
        let memory_bytes = memory.map_or(Ok(usual.memory_bytes), memory_bytes)?;
        let settings = SimulatorSettings { seed: Some(seed), threads, memory_bytes };
        let of = &scene.get().0;
        let precision = precision.map_or(Ok(Precision::F32), checked_precision)?;
        let made = scene.py().detach(|| AnySimulator::new(of, precision, &settings));
        let inner = Mutex::new(made.map_err(errors::of_rollout)?);
        let process = std::process::id();
        Ok(Self { scene: scene.unbind(), seed, precision, settings, is_bounded, progress, inner, process })
    }

    /// From what `__reduce__` gives.
    #[staticmethod]
    fn _of(
        scene: Bound<'_, Scene>,
        seed: u64,
        precision: &Bound<'_, PyAny>,
        threads: Option<usize>,
        memory_bytes: Option<u64>,
    ) -> PyResult<Self> {
        let (py, none) = (scene.py(), PyTuple::empty(scene.py()));
        let [seed, threads, memory] = [
            seed.into_pyobject(py)?.into_any(),
            threads.into_pyobject(py)?.into_any(),
            memory_bytes.into_pyobject(py)?.into_any(),
        ];
        Self::new(
            scene,
            &none,
            Some(&seed),
            Some(precision),
            Some(&threads).filter(|threads| !threads.is_none()),
            Some(&memory).filter(|memory| !memory.is_none()),
            None,
        )
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<Pickled<'py>> {
        let Self { scene, seed, precision, settings, is_bounded, .. } = slf.get();
        let memory_bytes = is_bounded.then_some(settings.memory_bytes);
        let parts = (scene.clone_ref(slf.py()), *seed, precision.name(), settings.threads, memory_bytes);
        Ok((slf.get_type().getattr("_of")?, parts))
    }

    /// `progress` may refer to whoever holds the simulator.
    fn __traverse__(&self, visit: PyVisit<'_>) -> Result<(), PyTraverseError> {
        visit.call(&self.scene)?;
        visit.call(&self.progress)
    }

    /// "f32" or "f64".
    #[getter]
    fn precision(&self) -> &'static str {
        self.precision.name()
    }

    /// Loss of the powder as it is packed, before it settles, metres: what lying still costs, or nearly.
    #[getter]
    fn initial_loss(&self, py: Python<'_>) -> f64 {
        py.detach(|| rollout::initial_loss(self.scene(), self.seed))
    }

    /// What a skill achieves: an Evaluation. Whether the arm may make the motion, `plan` asks, and not this: limits, and walls in the
    /// tool's way, are not looked at here.
    ///
    /// theta: depth, scooping angle, lift, transport, pouring angle, each from -1 to 1 within the scene's bounds; shape (5,).
    fn rollout(&self, py: Python<'_>, theta: Numbers<'_>) -> PyResult<Evaluation> {
        let theta = arrays::theta(&theta)?;
        let found = self.simulated(py, |s, _| s.as_dyn().evaluate(&theta))?;
        Ok(self.evaluation(&found))
    }

    /// What skills achieve, simulated side by side by all threads: a list of Evaluations. Where one comes to no end, MotionError: one by
    /// one they tell which it was.
    ///
    /// thetas: shape (n, 5).
    fn rollouts(&self, py: Python<'_>, thetas: Table<'_>) -> PyResult<Vec<Evaluation>> {
        let thetas = arrays::thetas(&thetas)?;
        let most = SKILLS_PER_THREAD * self.settings.thread_count();
        let map = SkillMap::new(self.scene());
        let found = self.simulated(py, |s, _| {
            // What is no motion is told before any is simulated.
            thetas.iter().try_for_each(|theta| map.controls(theta).map(drop))?;
            if thetas.is_empty() {
                return s.as_dyn().evaluate_all(&[]);
            }
            let (mut found, all) = (Vec::with_capacity(thetas.len()), thetas.len() as f64);
            for some in thetas.chunks(most) {
                let span = [found.len(), found.len() + some.len()].map(|done| done as f64 / all);
                found.extend(part(s.as_dyn(), span, |s| s.evaluate_all(some))?);
            }
            Ok(found)
        })?;
        Ok(found.iter().map(|found| self.evaluation(found)).collect())
    }

    /// What a skill achieves, and the gradient of its loss with respect to theta: an Evaluation and an array of shape (5,), metres of
    /// loss per unit of theta. The loss falls along its negative; what a step may be, its length does not say:
    ///
    ///     theta = np.clip(theta - 0.1 * gradient / np.linalg.norm(gradient), -1.0, 1.0)
    ///
    /// kind, and what it costs beside a rollout:
    ///
    /// - "restarted", some 5 rollouts: an adjoint that begins anew at some moments of the motion, from what grains cost on average
    ///   where they then are. It forgets what single grains do, and so holds over steps that a search takes; as a rule it points
    ///   where differences do, which a scene that wants an amount can spoil near the edge of its tolerance.
    /// - "differences", 11 rollouts, side by side: central ones over `half_step` of theta, at most up to the ends of its range.
    /// - "adjoint", some 7 rollouts: the exact derivative of the numbers that are computed. Single grains are chaotic, so that over a
    ///   whole motion it may point anywhere.
    #[pyo3(
        signature = (theta, *others, kind = None, half_step = None),
        text_signature = "($self, theta, *, kind='restarted', half_step=0.1)"
    )]
    fn gradient<'py>(
        &self,
        py: Python<'py>,
        theta: Numbers<'py>,
        others: &Bound<'py, PyTuple>,
        kind: Option<&Bound<'py, PyAny>>,
        half_step: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Evaluation, Bound<'py, PyArray1<f64>>)> {
        given::by_name(others, "gradient(theta, kind=\"restarted\")")?;
        let theta = arrays::theta(&theta)?;
        let kind = kind.map_or(Ok(Kind::Restarted), |kind| given::word("kind", kind, &Kind::ALL))?;
        let right = "from 1e-9 to 1, in units of theta";
        let half_step =
            half_step.map_or(Ok(0.1), |step| given::real("half_step", step, 1e-9..=1.0, right))?;
        let scene = &self.scene.get().0;
        let map = SkillMap::new(scene);
        if kind != Kind::Differences {
            self.check_memory()?;
        }
        let (found, gradient) = self.simulated(py, |s, _| match kind {
            Kind::Differences => differences(s.as_dyn(), &theta, half_step),
            Kind::Adjoint => {
                let linear = map.linearise(&theta)?;
                let (found, gradient) = s.as_dyn().simulate_with_gradient(&linear.controls)?;
                Ok((found, linear.pull_back(&gradient)))
            }
            Kind::Restarted => {
                map.controls(&theta)?;
                let restarts = Restarts::of_skill(scene, &map, &theta);
                let found = s.as_dyn().evaluate_restarted(&theta, &restarts)?;
                Ok((found.evaluation, found.gradient))
            }
        })?;
        Ok((self.evaluation(&found), arrays::array(py, &gradient)))
    }

    /// What any motion of the tool achieves, and the powder on its way: a Motion.
    ///
    /// displacements: one for each control step, translation in metres, then rotation vector in radians, both along the world's axes;
    /// shape (steps, 6). every: control steps from one frame to the next; the first frame is the settled powder, the last one the motion's
    /// end only if its steps are a multiple of `every`. start: where the tool
    /// begins, as `Scene.start_pose`, which it is if None. Neither limits nor walls in the tool's way are looked at; but the tool's origin
    /// stays within the simulated volume.
    #[pyo3(
        signature = (displacements, *others, every = None, start = None),
        text_signature = "($self, displacements, *, every=10, start=None)"
    )]
    fn motion<'py>(
        &self,
        py: Python<'py>,
        displacements: Table<'py>,
        others: &Bound<'py, PyTuple>,
        every: Option<&Bound<'py, PyAny>>,
        start: Option<Numbers<'py>>,
    ) -> PyResult<Motion> {
        given::by_name(others, "motion(displacements, every=10)")?;
        let whole =
            |every| given::whole("every", every, 1..=i128::from(u32::MAX), "a whole number, 1 at least");
        let every: usize = every.map_or(Ok(10), whole)?;
        let controls = arrays::displacements("displacements", &displacements)?;
        let anchor = self.anchor(start.as_ref())?;
        arrays::within(&self.scene.get().0, &anchor, &controls)?;
        let period_s = self.scene.get().0.time.control_period_s();
        let mut frames = Frames::with_room(controls.len() / every + 1, self.scene().particle_count())?;
        let (found, destinations) = self.simulated(py, |s, _| {
            let recording = Recording { anchor: &anchor, controls: &controls, every };
            s.as_dyn().record(&recording, &mut |snapshot| frames.take(snapshot))
        })?;
        let Frames { steps, tool, positions_m, velocities_m_s } = frames;
        let times_s: Vec<f64> = steps.iter().map(|step| *step as f64 * period_s).collect();
        Ok(Motion {
            evaluation: Py::new(py, self.evaluation(&found))?,
            times_s: arrays::array(py, &times_s).unbind(),
            tool: arrays::table(py, tool).unbind(),
            positions_m: arrays::frames(py, positions_m, steps.len()).unbind(),
            velocities_m_s: arrays::frames(py, velocities_m_s, steps.len()).unbind(),
            destinations,
        })
    }

    /// The loss of any motion, and its derivative with respect to each displacement, the others held: a number and an array of shape
    /// (steps, 6), per metre and per radian.
    ///
    /// displacements: as for `motion`. loss: None for the scene's; or a function of the particles' positions at the end, metres, shape
    /// (particles, 3), that returns a number and its derivative by each position, of the same shape. By the exact adjoint.
    #[pyo3(signature = (displacements, *, loss = None))]
    fn motion_gradient<'py>(
        &self,
        py: Python<'py>,
        displacements: Table<'py>,
        loss: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(f64, Bound<'py, PyArray2<f64>>)> {
        let controls = arrays::displacements("displacements", &displacements)?;
        arrays::within(&self.scene.get().0, &self.anchor(None)?, &controls)?;
        self.check_memory()?;
        let (value, gradient) = match loss {
            None => self.simulated(py, |s, _| {
                let (found, gradient) = s.as_dyn().simulate_with_gradient(&controls)?;
                Ok((found.loss, gradient))
            })?,
            Some(loss) => self.gradient_of(py, &controls, &loss.clone().unbind())?,
        };
        Ok((value, arrays::table(py, gradient.iter().map(DisplacementGradient::components).collect())))
    }

    /// A motion that is made piece by piece, so that what comes next may depend on what the powder does: an Episode, at whose beginning
    /// the powder has settled.
    ///
    /// start: as for `motion`.
    #[pyo3(signature = (*, start = None))]
    fn episode(slf: &Bound<'_, Self>, start: Option<Numbers<'_>>) -> PyResult<Episode> {
        let anchor = slf.get().anchor(start.as_ref())?;
        arrays::within(slf.get().scene(), &anchor, &[])?;
        let state = slf.get().simulated(slf.py(), |s, _| s.begin(&anchor))?;
        Ok(Episode::new(slf.clone().unbind(), state))
    }

    /// The plan of a skill: its motion in whole counts, checked against limits, walls and the scene's arm, and simulated as shipped.
    ///
    /// theta: as for `rollout`. Raises SkillError or PlanError where the arm may not or cannot make the motion.
    fn plan(&self, py: Python<'_>, theta: Numbers<'_>) -> PyResult<Plan> {
        let theta = arrays::theta(&theta)?;
        let scene = &self.scene.get().0;
        let unevaluated = py.detach(|| plan::Unevaluated::new(scene, &theta))?;
        let found = self.simulated(py, |s, _| s.as_dyn().simulate(unevaluated.controls()))?;
        unevaluated.plan(scene, self.seed, self.precision, &found)
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let scene: String = self.scene.bind(py).as_any().repr()?.extract()?;
        Ok(format!("Simulator({scene}, seed={}, precision={:?})", self.seed, self.precision.name()))
    }
}

impl Simulator {
    pub(crate) fn simulated<R: Send>(
        &self,
        py: Python<'_>,
        job: impl FnOnce(&mut AnySimulator, &Link) -> Result<R, RolloutError> + Send,
    ) -> PyResult<R> {
        if self.process != std::process::id() {
            return Err(PyRuntimeError::new_err(
                "this simulator was made before the process was forked, and its threads are not in this one: make one in each process",
            ));
        }
        simulated(py, &self.inner, self.progress.as_ref(), job)
    }

    pub(crate) fn evaluation(&self, found: &rollout::Evaluation) -> Evaluation {
        Evaluation::new(&self.scene.get().0, found)
    }

    pub(crate) fn scene(&self) -> &scene::Scene {
        &self.scene.get().0
    }

    pub(crate) fn period_s(&self) -> f64 {
        self.scene.get().0.time.control_period_s()
    }

    /// Whether the memory that was given, if it was, holds a gradient.
    fn check_memory(&self) -> PyResult<()> {
        if !self.is_bounded {
            return Ok(());
        }
        rollout::check_memory(self.scene(), self.precision, &self.settings, Workload::Gradient, 0)
            .map_err(errors::of_rollout)
    }

    fn anchor(&self, start: Option<&Numbers<'_>>) -> PyResult<Pose> {
        let usual = || Ok(*SkillMap::new(&self.scene.get().0).start_pose());
        start.map_or_else(usual, |start| arrays::pose("start", start))
    }

    /// The gradient of a loss that Python computes.
    fn gradient_of(
        &self,
        py: Python<'_>,
        controls: &[Displacement],
        loss: &Py<PyAny>,
    ) -> PyResult<(f64, Vec<DisplacementGradient>)> {
        let raised = Mutex::new(None);
        let found = self.simulated(py, |s, link| {
            let custom = |positions_m: &[[f64; 3]], slopes: &mut [[f64; 3]]| {
                Python::attach(|py| ask(py, loss, positions_m, slopes)).unwrap_or_else(|error| {
                    *raised.lock().unwrap_or_else(|poison| poison.into_inner()) = Some(error);
                    link.stop();
                    0.0
                })
            };
            s.as_dyn().gradient_of_custom_loss(controls, &custom)
        });
        match raised.into_inner() {
            Ok(Some(error)) => Err(error),
            _ => found,
        }
    }
}

/// Calls a loss of Python's.
fn ask(py: Python<'_>, loss: &Py<PyAny>, positions_m: &[[f64; 3]], slopes: &mut [[f64; 3]]) -> PyResult<f64> {
    let answer = loss.bind(py).call1((arrays::table(py, positions_m.to_vec()),))?;
    let (value, found): (f64, PyReadonlyArray2<'_, f64>) = answer.extract().map_err(|_| {
        let wanted = format!("a number and an array of shape ({}, 3), 64 bits", slopes.len());
        PyTypeError::new_err(format!("the loss returned {answer}, but it must return {wanted}"))
    })?;
    let found = found.as_array();
    if found.shape() != [slopes.len(), 3] {
        return Err(PyValueError::new_err(format!(
            "the loss returned a derivative of shape {:?}, but it must be ({}, 3), as the positions are",
            found.shape(),
            slopes.len()
        )));
    }
    let wrong =
        |what: String| Err(PyValueError::new_err(format!("the loss returned {what}, but it must be finite")));
    if !value.is_finite() {
        return wrong(value.to_string());
    }
    for (particle, (slope, row)) in slopes.iter_mut().zip(found.rows()).enumerate() {
        *slope = std::array::from_fn(|k| row[k]);
        if !slope.iter().all(|slope| slope.is_finite()) {
            return wrong(format!("a derivative of {slope:?} for particle {particle}"));
        }
    }
    Ok(value)
}

/// Central differences, at the ends of the range over what is left of it.
fn differences(
    simulator: &mut dyn Simulate,
    theta: &Theta,
    half_step: f64,
) -> Result<(rollout::Evaluation, ThetaGradient), RolloutError> {
    let both_ways = |which| [theta.moved(which, half_step), theta.moved(which, -half_step)];
    let all: Vec<Theta> =
        std::iter::once(*theta).chain(SkillParameter::ALL.into_iter().flat_map(both_ways)).collect();
    let found = simulator.evaluate_all(&all)?;
    let slope = |which: SkillParameter| {
        let [up, down] = [1, 2].map(|k| 2 * which.index() + k);
        (found[up].loss - found[down].loss) / (all[up][which] - all[down][which])
    };
    Ok((found[0], SkillParameter::ALL.map(slope)))
}

/// Snapshots, one after another.
#[derive(Default)]
struct Frames {
    steps: Vec<usize>,
    tool: Vec<[f64; 7]>,
    positions_m: Vec<[f32; 3]>,
    velocities_m_s: Vec<[f32; 3]>,
}

impl Frames {
    /// With the memory of all of them, so that none is moved later: it is what NumPy's arrays hold in the end.
    fn with_room(frames: usize, particles: usize) -> PyResult<Self> {
        let mut made = Self::default();
        let rows = frames.saturating_mul(particles);
        let room = made
            .positions_m
            .try_reserve_exact(rows)
            .and_then(|()| made.velocities_m_s.try_reserve_exact(rows));
        room.map(|()| made).map_err(|_| {
            let size = format_size(rows.saturating_mul(24) as u64);
            PyMemoryError::new_err(format!(
                "{frames} frames of {particles} particles take {size}, more than there is: a larger `every` keeps fewer"
            ))
        })
    }

    fn take(&mut self, snapshot: &Snapshot<'_>) -> ControlFlow<()> {
        self.steps.push(snapshot.step);
        self.tool.push(arrays::of_pose(&snapshot.tool));
        self.positions_m.extend_from_slice(snapshot.positions_m);
        self.velocities_m_s.extend_from_slice(snapshot.velocities_m_s);
        ControlFlow::Continue(())
    }
}
