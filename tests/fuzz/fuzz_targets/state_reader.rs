//! The state of a run with anything in it, as it is and with a right beginning and checksum: refused in one sentence, or
//! something that a run can go on from.
#![no_main]

use libfuzzer_sys::fuzz_target;
use powderline_fuzz::{assert_sentence, plant};
use powderline_optimiser::cli::{Progress, Stream};
use powderline_optimiser::optim::{Answer, Method, Probe, Search};
use powderline_optimiser::report::{amounts::Amounts, curves::Curves, state::RunState};
use powderline_shared::plan::Precision;
use powderline_simulator::rollout::{Census, Evaluation};
use powderline_simulator::scene::{DEFAULT_SCENE, Scene};
use powderline_simulator::skill::{SkillMap, Theta};
use sha2::{Digest, Sha256};
use std::sync::LazyLock;

/// Magic and version.
const HEAD_BYTES: usize = 12;
/// SHA-256.
const CHECKSUM_BYTES: usize = 32;

static SCENE: LazyLock<Scene> = LazyLock::new(|| Scene::load(DEFAULT_SCENE).expect("it is shipped"));
static METHOD: LazyLock<Method> = LazyLock::new(|| Method::new(&SCENE, 3));
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
    go_on(state.search);
}

/// As a run does that is resumed: one more epoch, its line, the curves, the state.
fn go_on(mut search: Search) {
    search.extend(search.epochs().saturating_add(1));
    let progress = Progress::new(&Stream::new(std::io::sink()), true);
    if let Some(request) = search.next(&METHOD) {
        progress.begin("epoch", search.epochs() - request.epoch, search.history());
        record(&mut search);
    }
    if let Some(last) = search.history().last() {
        progress.epoch(last, &Amounts::from(&*SCENE), [search.epochs(); 2], search.history());
    }
    let curves = Curves {
        title: ["fuzzed", "by bytes"],
        history: search.history(),
        epochs: search.epochs(),
        curriculum_epochs: METHOD.rule.curriculum_epochs,
        shipped: search.history().last().map(|record| record.epoch),
        plan: None,
        passed_over: &[0],
        map: &SkillMap::new(&SCENE),
        amounts: &Amounts::from(&*SCENE),
    };
    assert!(curves.to_svg().expect("curves can be drawn").ends_with("</svg>\n"));
    let state = RunState { search, ..state(0) };
    assert!(RunState::from_bytes(&state.to_bytes()).is_ok());
}

/// One epoch, evaluated by a bowl.
fn record(search: &mut Search) {
    let Some(request) = search.next(&METHOD) else { return };
    let loss = |theta: &Theta| theta.components().iter().map(|value| value * value).sum::<f64>();
    let census = Census { target: 2, spilled: 3, tool: 4, ..Census::default() };
    let answer = Answer {
        evaluation: Evaluation::new(loss(&request.theta), 1, census),
        adjoint: request.want_gradient.then_some(request.theta.components()),
    };
    let probes = search.probes(&METHOD, answer.adjoint.as_ref());
    let losses = |probes: Vec<Probe>| probes.iter().map(|probe| loss(&probe.theta)).collect();
    let mut rings: Vec<Vec<f64>> = vec![losses(probes)];
    while let Ok(wider) = search.wider(&METHOD, &answer, &rings) {
        match wider.is_empty() {
            true => break,
            false => rings.push(losses(wider)),
        }
    }
    // Refused where numbers of the state are too large to go on with.
    let _ = search.record(&METHOD, &answer, &rings, 1.5);
}

/// A run of two epochs, of which some are done.
fn state(done: usize) -> RunState {
    let first = Theta::new([0.1, -0.2, 1.0 / 3.0, 0.0, -1.0]).expect("it is in the range");
    let mut search = Search::new(first, 2);
    (0..done).for_each(|_| record(&mut search));
    RunState::new([7; 32], 3, Precision::F32, search)
}

/// Runs at all their ages, whole and without what the target adds.
fn seeds() -> impl Iterator<Item = Vec<u8>> {
    (0..=3).map(|done| state(done).to_bytes()).flat_map(|bytes| {
        let body = bytes[HEAD_BYTES..bytes.len() - CHECKSUM_BYTES].to_vec();
        [bytes, body]
    })
}
