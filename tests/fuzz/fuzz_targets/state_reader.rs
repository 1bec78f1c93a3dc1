//! The state of a run with anything in it, as it is and with a right beginning and checksum: refused in one sentence, or
//! something that a run can go on from.
#![no_main]

use libfuzzer_sys::fuzz_target;
use powderline_fuzz::{assert_sentence, plant};
use powderline_optimiser::cli::{Progress, Stream};
use powderline_optimiser::optim::{EpochRecord, Found, Method, Problem, Search, Work};
use powderline_optimiser::report::state::{Evaluated, RunState, Settings};
use powderline_optimiser::report::{amounts::Amounts, curves::Curves, tries::Try};
use powderline_shared::plan::Precision;
use powderline_simulator::rollout::{Census, Evaluation};
use powderline_simulator::scene::{DEFAULT_SCENE, Scene};
use powderline_simulator::skill::SkillMap;
use sha2::{Digest, Sha256};
use std::sync::LazyLock;

/// Magic and version.
const HEAD_BYTES: usize = 12;
/// SHA-256.
const CHECKSUM_BYTES: usize = 32;

static SCENE: LazyLock<Scene> = LazyLock::new(|| Scene::load(DEFAULT_SCENE).expect("it is shipped"));
static HEAD: LazyLock<Vec<u8>> = LazyLock::new(|| state(0).to_bytes()[..HEAD_BYTES].to_vec());

fuzz_target!(init: plant(seeds()), |bytes: &[u8]| {
    check(bytes);
    let mut sealed = [&HEAD[..], bytes].concat();
    sealed.extend(Sha256::digest(&sealed));
    check(&sealed);
});

fn check(bytes: &[u8]) {
    let state = match RunState::from_bytes(bytes) {
        Ok(state) => state,
        Err(error) => return assert_sentence(&error),
    };
    let written = state.to_bytes();
    let again = RunState::from_bytes(&written).expect("what is written can be read");
    assert_eq!(again.to_bytes(), written);
    go_on(state);
}

/// As a run does that is resumed: the search is made again as far as it goes along, then its line, the curves, the state.
fn go_on(mut state: RunState) {
    state.extend(state.settings.epochs.saturating_add(1));
    replay(&state);
    let history = state.history();
    let progress = Progress::new(&Stream::new(std::io::sink()), true);
    progress.begin("epoch", 1, &history);
    if let Some(last) = history.last() {
        progress.epoch(last, &Amounts::from(&*SCENE), [state.settings.epochs; 2], &history);
    }
    let curves = Curves {
        title: ["fuzzed", "by bytes"],
        history: &history,
        epochs: state.settings.epochs,
        shipped: history.last().map(|record| record.epoch),
        plan: None,
        passed_over: &[0],
        map: &SkillMap::new(&SCENE),
        amounts: &Amounts::from(&*SCENE),
    };
    assert!(curves.to_svg().expect("curves can be drawn").ends_with("</svg>\n"));
    assert!(RunState::from_bytes(&state.to_bytes()).is_ok());
}

/// Tells a search what the state says that it was told.
fn replay(state: &RunState) {
    let mut search = state.settings.method.search(&Problem::new(&SCENE, state.seed));
    for (number, epoch) in state.epochs.iter().enumerate() {
        for round in &epoch.rounds {
            let found: Vec<Found> = round.iter().map(Try::found).collect();
            if search.ask(state.is_last(number)).is_empty() || search.tell(&found).is_err() {
                return;
            }
        }
    }
}

/// One epoch, evaluated by a bowl.
fn evaluated(search: &mut dyn Search, epoch: u32) -> Evaluated {
    let (mut rounds, mut work) = (Vec::new(), Work::default());
    loop {
        let trials = search.ask(false);
        let census = Census { target: 2, spilled: 3, tool: 4, ..Census::default() };
        let found = trials.iter().map(|trial| {
            let loss = trial.point.iter().map(|value| value * value).sum();
            let gradient = trial.adjoint.map(|_| trial.point.clone());
            Found { evaluation: Evaluation::new(loss, 1, census), gradient }
        });
        let found: Vec<Found> = found.collect();
        let tries: Vec<Try> =
            trials.iter().zip(&found).map(|(trial, found)| Try::new(epoch, trial, found, 0.5)).collect();
        tries.iter().for_each(|one| work.add(&one.work()));
        rounds.push(tries);
        if let Some(ended) = search.tell(&found).expect("a bowl has slopes") {
            let record = EpochRecord::new(epoch, &ended, work, 1.5).expect("it is a skill's");
            return Evaluated { record, rounds };
        }
    }
}

/// A run of three epochs, of which some are done.
fn state(done: u32) -> RunState {
    run(Method::Mixed, done)
}

fn run(method: Method, done: u32) -> RunState {
    let settings = Settings { method, epochs: 2, ..Settings::default() };
    let mut state = RunState::new(SCENE.digest(), 3, Precision::F32, settings);
    let mut search = method.search(&Problem::new(&SCENE, 3));
    state.epochs = (0..done).map(|epoch| evaluated(search.as_mut(), epoch)).collect();
    state
}

/// Runs at all their ages, whole and without what the target adds.
fn seeds() -> impl Iterator<Item = Vec<u8>> {
    let runs = [Method::Surrogate, Method::Mixed].into_iter().flat_map(|method| (0..=3).map(move |done| run(method, done)));
    runs.map(|state| state.to_bytes()).flat_map(|bytes| {
        let body = bytes[HEAD_BYTES..bytes.len() - CHECKSUM_BYTES].to_vec();
        [bytes, body]
    })
}
