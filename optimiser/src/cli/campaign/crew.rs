//! Processes that do cases side by side: what one of them comes to, the others do not notice.
//!
//! A worker is this program again, as `optimise campaign --worker DIR`. It is told a case's number in a line on its standard input,
//! does the case, whose outcome it writes into the case's folder, and answers a line: `done`, `stopped`, or `broken` with why. Where
//! its input ends, it stops as at Ctrl-C: so it does when whoever started it is no more.

use super::case::{folder_of, perform, write_down};
use crate::{
    campaign::{Campaign, End, Outcome},
    cli::{CliError, Context, Interrupt, Memory, Resources, options::DEFAULT_PRECISION, size::format_size},
    failure::of_file,
};
use std::{
    collections::VecDeque,
    fs::{File, OpenOptions, TryLockError},
    io::{self, BufRead, BufReader, Read, Write},
    path::Path,
    process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio},
    sync::{
        Mutex, PoisonError,
        mpsc::{RecvTimeoutError, Sender, channel},
    },
    thread,
    time::Duration,
};

/// File that is locked, shared, by all workers of a campaign.
const WORKERS: &str = "workers";

/// From one look at Ctrl-C to the next.
const LOOK: Duration = Duration::from_millis(100);

/// What is kept of what a worker says last, bytes.
const LAST_WORDS: usize = 4096;

/// How many workers there are, and what each may take.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crew {
    pub(super) workers: usize,
    pub(super) each: Resources,
}

/// What is told of the work.
pub(super) enum Told<'a> {
    /// A case has come to an end.
    Done(u64),
    /// Time goes on.
    Tick,
    /// Something to say.
    Words(&'a str),
}

/// What cases are of, and where they are done.
#[derive(Clone, Copy)]
pub(super) struct Site<'a> {
    pub(super) campaign: &'a Campaign,
    /// With the campaign's file.
    pub(super) folder: &'a Path,
    /// This program once more.
    pub(super) program: &'a (dyn Fn() -> Command + Sync),
}

/// What is still to be done, and who is at work.
struct Work<'a> {
    site: Site<'a>,
    left: Mutex<VecDeque<u64>>,
    /// What workers listen to: closed, they stop.
    inputs: Vec<Mutex<Option<ChildStdin>>>,
    interrupt: &'a Interrupt,
}

/// Does these cases, and tells of each.
///
/// # Errors
/// It was stopped, or a folder cannot be used.
pub(super) fn work(
    site: Site<'_>,
    cases: &[u64],
    crew: Crew,
    interrupt: &Interrupt,
    tell: &mut dyn FnMut(Told<'_>) -> Result<(), CliError>,
) -> Result<(), CliError> {
    wait_for_others(site.folder, interrupt, tell)?;
    let work = Work {
        site,
        left: Mutex::new(cases.iter().copied().collect()),
        inputs: (0..crew.workers).map(|_| Mutex::new(None)).collect(),
        interrupt,
    };
    let (told, news) = channel();
    thread::scope(|scope| {
        for place in 0..crew.workers {
            let (work, told) = (&work, told.clone());
            scope.spawn(move || work.employ(place, crew.each, &told));
        }
        drop(told);
        let mut ended = Ok(());
        loop {
            let heard = match news.recv_timeout(LOOK) {
                Ok(Ok(case)) => tell(Told::Done(case)),
                Ok(Err(error)) => Err(error),
                Err(RecvTimeoutError::Timeout) => tell(Told::Tick),
                Err(RecvTimeoutError::Disconnected) => break,
            };
            if ended.is_ok() && heard.is_err() {
                ended = heard;
            }
            // Again and again: a worker that is just being started does not hear it yet.
            if ended.is_err() || interrupt.is_requested() {
                work.stop();
            }
        }
        let stopped = || Err(CliError::Interrupted("stopped on request".into()));
        if ended.is_ok() && interrupt.is_requested() { stopped() } else { ended }
    })
}

/// Workers of a session that was killed may still be about to stop.
fn wait_for_others(
    folder: &Path,
    interrupt: &Interrupt,
    tell: &mut dyn FnMut(Told<'_>) -> Result<(), CliError>,
) -> Result<(), CliError> {
    let file = lockable(folder)?;
    let mut said = false;
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(()),
            Err(TryLockError::WouldBlock) if interrupt.is_requested() => {
                return Err(CliError::Interrupted("stopped on request".into()));
            }
            Err(TryLockError::WouldBlock) => {
                if !said {
                    tell(Told::Words("waiting for what an earlier session is still about to finish"))?;
                }
                said = true;
                thread::sleep(LOOK);
            }
            Err(TryLockError::Error(error)) => return Err(of_file(&folder.join(WORKERS), "locked")(error)),
        }
    }
}

fn lockable(folder: &Path) -> Result<File, CliError> {
    let file = folder.join(WORKERS);
    OpenOptions::new().write(true).create(true).truncate(false).open(&file).map_err(of_file(&file, "opened"))
}

/// A worker that is at work, as its employer sees it.
struct Employed {
    child: Child,
    answers: BufReader<ChildStdout>,
    /// Ends with what it says last on standard error.
    last_words: thread::JoinHandle<String>,
}

impl Work<'_> {
    fn next(&self) -> Option<u64> {
        self.left.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
    }

    /// Nothing more is begun, and what is at work stops where it can be gone on with.
    fn stop(&self) {
        self.left.lock().unwrap_or_else(PoisonError::into_inner).clear();
        for input in &self.inputs {
            drop(input.lock().unwrap_or_else(PoisonError::into_inner).take());
        }
    }

    /// One case after another, by a worker that is replaced when it is gone.
    fn employ(&self, place: usize, each: Resources, told: &Sender<Result<u64, CliError>>) {
        let mut worker = None;
        while let Some(case) = self.next() {
            let done = match self.asked(place, case, each, &mut worker) {
                Ok(true) => told.send(Ok(case)),
                // It was stopped.
                Ok(false) => break,
                Err(error) => {
                    // Whoever hears it ends the campaign, and nobody waits for a further case.
                    let _ = told.send(Err(error));
                    break;
                }
            };
            if done.is_err() {
                break;
            }
        }
        drop(self.inputs[place].lock().unwrap_or_else(PoisonError::into_inner).take());
        if let Some(mut worker) = worker {
            let _ = worker.child.wait();
        }
    }

    /// Whether the case came to its end.
    fn asked(
        &self,
        place: usize,
        case: u64,
        each: Resources,
        worker: &mut Option<Employed>,
    ) -> Result<bool, CliError> {
        let mut employed = match worker.take() {
            Some(employed) => employed,
            None => self.started(place, each)?,
        };
        let answer = {
            let mut input = self.inputs[place].lock().unwrap_or_else(PoisonError::into_inner);
            // Where it does not hear any more, it does not answer either.
            input.as_mut().map(|input| writeln!(input, "{case}").and_then(|()| input.flush()))
        };
        let mut line = String::new();
        if answer.is_some() {
            employed.answers.read_line(&mut line)?;
        }
        if answer.is_none() {
            // It was stopped before it heard of the case.
            employed
                .child
                .wait()
                .map_err(|error| CliError::Failed(format!("a worker does not end: {error}")))?;
            return Ok(false);
        }
        match line.trim_end().split_once(' ').unwrap_or((line.trim_end(), "")) {
            ("done", _) => {
                *worker = Some(employed);
                Ok(true)
            }
            ("broken", why) => Err(CliError::Failed(why.into())),
            ("stopped", _) if self.is_stopped(place) => Ok(false),
            ("stopped", _) => self.lost(case, employed, Some("was stopped by somebody else")),
            _ => self.lost(case, employed, None),
        }
    }

    /// Whether a worker was asked to stop from here.
    fn is_stopped(&self, place: usize) -> bool {
        let input = self.inputs[place].lock().unwrap_or_else(PoisonError::into_inner);
        input.is_none() || self.interrupt.is_requested()
    }

    /// What is written of a case in the midst of which its worker is gone, by its own words or by how its process ended.
    fn lost(&self, case: u64, mut employed: Employed, how: Option<&str>) -> Result<bool, CliError> {
        let status = employed.child.wait()?;
        let last_words = employed.last_words.join().unwrap_or_default();
        if self.interrupt.is_requested() {
            return Ok(false);
        }
        let case = self.site.campaign.case(case);
        let scene = case.setting.scene().map_err(|error| CliError::Failed(error.to_string()))?;
        let how = how.map_or_else(|| ended(status), String::from);
        let why = format!("its process {how}{}", said(&last_words));
        let folder = folder_of(self.site.folder, &case);
        write_down(&folder, Outcome { key: case.key(&scene), end: End::Error(why) })?;
        Ok(true)
    }

    fn started(&self, place: usize, each: Resources) -> Result<Employed, CliError> {
        let mut command = (self.site.program)();
        command.arg("campaign").arg("--worker").arg(self.site.folder);
        command.arg("--threads").arg(each.threads.unwrap_or(1).to_string());
        command.arg("--memory").arg(each.memory.bytes().to_string());
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let failed = |error| CliError::Failed(format!("no worker can be started: {error}"));
        let mut child = command.spawn().map_err(failed)?;
        *self.inputs[place].lock().unwrap_or_else(PoisonError::into_inner) = child.stdin.take();
        let (Some(answers), Some(errors)) = (child.stdout.take(), child.stderr.take()) else {
            return Err(CliError::Failed("no worker can be started: it has no pipes".into()));
        };
        let last_words = thread::spawn(move || last_words(errors));
        Ok(Employed { child, answers: BufReader::new(answers), last_words })
    }
}

/// The end of what somebody says, once it is all said.
fn last_words(mut errors: ChildStderr) -> String {
    let (mut kept, mut more) = (Vec::new(), [0; 1024]);
    while let Ok(count @ 1..) = errors.read(&mut more) {
        kept.extend_from_slice(&more[..count]);
        kept.drain(..kept.len().saturating_sub(LAST_WORDS));
    }
    String::from_utf8_lossy(&kept).into_owned()
}

/// The last line that says anything.
fn said(words: &str) -> String {
    let last = words.lines().map(str::trim).rfind(|line| !line.is_empty() && !line.starts_with("note:"));
    last.map_or(String::new(), |line| format!(": {line}"))
}

#[cfg(unix)]
fn ended(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match status.signal() {
        Some(9) => "was killed (by signal 9: by somebody, or by a system without memory)".into(),
        Some(signal) => format!("was ended by signal {signal}"),
        None => format!("ended with {status}"),
    }
}

#[cfg(not(unix))]
fn ended(status: ExitStatus) -> String {
    format!("ended with {status}")
}

/// What a worker does, until its input ends.
///
/// # Errors
/// The folder holds no campaign.
pub(super) fn serve(
    campaign: &Campaign,
    folder: &Path,
    resources: Resources,
    context: &mut Context<'_>,
) -> Result<(), CliError> {
    let workers = lockable(folder)?;
    workers.lock_shared()?;
    let (hear, heard) = channel::<u64>();
    let gone = context.interrupt.clone();
    thread::spawn(move || {
        for line in io::stdin().lines() {
            let Some(case) = line.ok().and_then(|line| line.trim().parse().ok()) else { break };
            if hear.send(case).is_err() {
                break;
            }
        }
        gone.request();
    });
    // Ends with the thread, which asks for a stop before.
    while let Ok(case) = heard.recv() {
        let answer = match perform(campaign, folder, case, resources, &context.interrupt) {
            Ok(_) => "done".to_owned(),
            Err(CliError::Interrupted(_)) => "stopped".to_owned(),
            Err(error) => format!("broken {}", error.to_string().replace('\n', "; ")),
        };
        writeln!(context.out, "{answer}")?;
        context.out.flush()?;
        if answer != "done" {
            break;
        }
    }
    Ok(())
}

/// How many workers do these cases, and what each may take: one for each thread that there is, if memory allows.
///
/// # Errors
/// Not even one can work in so much memory.
pub(super) fn crew(
    cases: usize,
    resources: Resources,
    needs: &dyn Fn(Resources) -> Result<(), CliError>,
) -> Result<Crew, CliError> {
    /// What the process that watches over the others takes, bytes.
    const EMPLOYER_BYTES: u64 = 24 << 20;
    let remark = format!(
        "{} of --memory are for the process that watches over the cases",
        format_size(EMPLOYER_BYTES)
    );
    let threads = resources.setup(0, DEFAULT_PRECISION).settings.thread_count();
    let bytes = resources.memory.bytes().saturating_sub(EMPLOYER_BYTES);
    let of = |workers: usize| Crew {
        workers,
        each: Resources {
            threads: Some((threads / workers).max(1) as u16),
            memory: Memory::Bytes(bytes / workers as u64),
        },
    };
    let most = threads.min(cases).max(1);
    let fits = (1..=most).rev().map(of).find(|crew| needs(crew.each).is_ok());
    match fits {
        Some(crew) => Ok(crew),
        None => needs(of(1).each).map(|()| of(1)).map_err(|error| error.with_remark(&remark)),
    }
}
