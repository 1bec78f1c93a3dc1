//! Campaigns, as far as somebody else has their cases done: `python/powderline/campaign.py` and `_tasks.py`.

use std::path::PathBuf;
use std::process::Command;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, mpsc};

use powderline_optimiser::campaign::{self, Case, Found, Outcome};
use powderline_optimiser::cli::{self, CliError, Experiment, Interrupt, Memory, Resources};
use pyo3::{exceptions::PyIndexError, prelude::*};
use serde::Serialize;

use crate::simulator::{checked_threads, memory_bytes};
use crate::watched::meanwhile;
use crate::{errors, json};

/// Benches, powders, amounts, draws and seeds, each combined with each.
#[pyclass(frozen, module = "powderline._native")]
pub(crate) struct Campaign(Arc<campaign::Campaign>);

/// What a case is.
#[derive(Serialize)]
struct Row<'a> {
    case: &'a str,
    bench: &'a str,
    powder: Option<&'a str>,
    amount_kg: Option<f64>,
    /// From 1, as in the case's name.
    draw: Option<u32>,
    seed: u64,
    #[serde(flatten)]
    became: Option<Became<'a>>,
}

/// What became of it.
#[derive(Serialize)]
struct Became<'a> {
    status: &'static str,
    error: Option<&'a str>,
    #[serde(flatten)]
    found: Option<&'a Found>,
}

impl<'a> Row<'a> {
    fn of(case: &'a Case<'a>, outcome: Option<&'a Outcome>) -> Self {
        let setting = &case.setting;
        let became = |outcome: &'a Outcome| Became {
            status: outcome.status().name(),
            error: outcome.error(),
            found: outcome.found(),
        };
        Self {
            case: &case.name,
            bench: setting.bench(),
            powder: setting.powder(),
            amount_kg: setting.amount_kg,
            draw: setting.draw.map(|draw| draw + 1),
            seed: case.seed,
            became: outcome.map(became),
        }
    }
}

fn each(threads: &Bound<'_, PyAny>, memory: &Bound<'_, PyAny>) -> PyResult<Resources> {
    let threads = checked_threads(threads)?;
    Ok(Resources { threads: Some(threads), memory: Memory::Bytes(memory_bytes(memory)?) })
}

#[pymethods]
impl Campaign {
    /// The campaign of a file.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        let loaded = campaign::Campaign::load(&path).map_err(|error| errors::of_command(error.into()))?;
        Ok(Self(Arc::new(loaded)))
    }

    #[getter]
    fn name(&self) -> &str {
        &self.0.file().name
    }

    /// Whether each case is one rollout, and no search.
    #[getter]
    fn is_of_rollouts(&self) -> bool {
        self.0.is_of_rollouts()
    }

    fn __len__(&self) -> usize {
        self.0.case_count() as usize
    }

    /// What a case is, by its number.
    fn case<'py>(&self, py: Python<'py>, index: u64) -> PyResult<Bound<'py, PyAny>> {
        if index >= self.0.case_count() {
            return Err(PyIndexError::new_err(format!("there are {} cases", self.0.case_count())));
        }
        json::to_python(py, &Row::of(&self.0.case(index), None))
    }

    /// Its files: the campaign's own, and the benches.
    fn files(&self) -> Vec<(String, String)> {
        let (text, mut files) = self.0.to_files();
        files.push(("campaign.toml".into(), text));
        files
    }

    /// Looks at every case, and whether each can be done with so many threads and so much memory; returns that in bytes.
    fn check(&self, py: Python<'_>, threads: &Bound<'_, PyAny>, memory: &Bound<'_, PyAny>) -> PyResult<u64> {
        let (each, interrupt) = (each(threads, memory)?, Interrupt::default());
        let job = || cli::check_apart(&self.0, each, &interrupt);
        let (found, raised) = meanwhile(py, job, || interrupt.request(), |_| Ok(()));
        raised?;
        found.map_err(errors::of_command)?;
        Ok(each.memory.bytes())
    }
}

/// A campaign's folder, open and locked.
#[pyclass(frozen, module = "powderline._native")]
pub(crate) struct CampaignFolder(Mutex<Experiment>);

impl CampaignFolder {
    fn inner(&self) -> MutexGuard<'_, Experiment> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whatever tells of a case: its status then, and the words.
    fn told(
        &self,
        py: Python<'_>,
        index: u64,
        tell: impl FnOnce(&mut Experiment) -> Result<String, CliError> + Send,
    ) -> PyResult<(&'static str, String)> {
        self.known(index)?;
        let told = py.detach(|| {
            let mut experiment = self.inner();
            let words = tell(&mut experiment)?;
            let outcome = experiment.outcomes()[index as usize].as_ref();
            Ok((outcome.map_or("open", |outcome| outcome.status().name()), words))
        });
        told.map_err(errors::of_command)
    }

    fn known(&self, index: u64) -> PyResult<()> {
        let count = self.inner().campaign().case_count();
        if index < count { Ok(()) } else { Err(PyIndexError::new_err(format!("there are {count} cases"))) }
    }
}

#[pymethods]
impl CampaignFolder {
    /// Begins a campaign in a new folder, `runs/<name>` if None.
    #[staticmethod]
    fn start(campaign: &Campaign, out: Option<PathBuf>) -> PyResult<Self> {
        let begun = Experiment::start((*campaign.0).clone(), out.as_deref()).map_err(errors::of_command)?;
        Ok(Self(Mutex::new(begun)))
    }

    /// Goes on with what a folder holds.
    #[staticmethod]
    fn open(campaign: &Campaign, folder: PathBuf) -> PyResult<Self> {
        let open = Experiment::open((*campaign.0).clone(), &folder).map_err(errors::of_command)?;
        Ok(Self(Mutex::new(open)))
    }

    #[getter]
    fn path(&self) -> PathBuf {
        self.inner().path().into()
    }

    /// Numbers of the cases that are still to be done; one that failed is tried again.
    fn left(&self) -> Vec<u64> {
        self.inner().left()
    }

    /// Takes in what a case that was done elsewhere has left behind: its status, and words about it.
    fn deliver(
        &self,
        py: Python<'_>,
        index: u64,
        files: Vec<(String, Vec<u8>)>,
    ) -> PyResult<(&'static str, String)> {
        self.told(py, index, |experiment| experiment.deliver(index, &files))
    }

    /// Writes down why a case came to nothing.
    fn fail(&self, py: Python<'_>, index: u64, why: String) -> PyResult<(&'static str, String)> {
        self.told(py, index, |experiment| experiment.fail(index, why))
    }

    /// Writes table and page.
    fn write(&self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| self.inner().write()).map_err(errors::of_command)
    }

    fn verdict(&self) -> String {
        self.inner().verdict()
    }

    /// Exit code of the program, and what it says at last, where not all came to what was wanted.
    fn judged(&self) -> (u8, Option<String>) {
        let judged = self.inner().judged();
        (judged.as_ref().map_or_else(CliError::code, |()| 0), judged.err().map(|error| error.to_string()))
    }

    /// What each case that has come to its end is, and what became of it, in their order.
    fn outcomes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let experiment = self.inner();
        let cases: Vec<Case<'_>> = experiment.campaign().cases().collect();
        let known = cases.iter().zip(experiment.outcomes()).filter(|(_, outcome)| outcome.is_some());
        let rows: Vec<Row<'_>> = known.map(|(case, outcome)| Row::of(case, outcome.as_ref())).collect();
        json::to_python(py, &rows)
    }
}

/// Does cases of the campaign in a folder, one after another, in a process of its own, which the words of `program` begin; calls
/// `ended` with each.
#[pyfunction]
pub(crate) fn perform_cases(
    py: Python<'_>,
    folder: PathBuf,
    cases: Vec<u64>,
    threads: &Bound<'_, PyAny>,
    memory: &Bound<'_, PyAny>,
    program: Vec<String>,
    ended: Py<PyAny>,
) -> PyResult<()> {
    let (each, interrupt) = (each(threads, memory)?, Interrupt::default());
    let (tell, told) = mpsc::channel::<u64>();
    let told = Mutex::new(told);
    let look = |py: Python<'_>| -> PyResult<()> {
        for case in told.lock().unwrap_or_else(PoisonError::into_inner).try_iter() {
            ended.call1(py, (case,))?;
        }
        Ok(())
    };
    let begin = || {
        let mut words = program.iter();
        let mut command = Command::new(words.next().map_or("optimise", String::as_str));
        command.args(words);
        command
    };
    let job = || {
        let mut tell = |case| {
            // Nobody hears it where Python has raised something.
            let _ = tell.send(case);
        };
        cli::perform_apart(&folder, &cases, each, &begin, &interrupt, &mut tell)
    };
    let (found, raised) = meanwhile(py, job, || interrupt.request(), look);
    raised?;
    look(py)?;
    found.map_err(errors::of_command)
}
