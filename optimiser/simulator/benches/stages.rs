//! Each stage of a substep of 20,000 particles, forward and adjoint, one thread: nanoseconds per call and particles per
//! second. `optimise bench` is the tool that says more; this one compares with its own last run.
//!
//! A stage is timed inside whole substeps, so a sample takes several times as long as it shows.
#![expect(missing_docs, reason = "what the macros of criterion write has none")]

use std::time::Duration;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use powderline_simulator::bench::{Bench, Elementary, STAGES};

const PARTICLES: usize = 20_000;

fn stages<T: Elementary>(criterion: &mut Criterion, precision: &str) {
    let mut bench = Bench::<T>::new(PARTICLES, 64, 1).expect("the bed fits");
    let mut group = criterion.benchmark_group(precision);
    group.throughput(Throughput::Elements(PARTICLES as u64));
    group.sample_size(10).warm_up_time(Duration::from_millis(100)).measurement_time(Duration::from_secs(1));
    for stage in STAGES {
        group.bench_function(format!("{stage:?}"), |bencher| {
            bencher.iter_custom(|calls| {
                Duration::from_secs_f64(
                    1e-9 * bench.time_of(stage, calls).expect("the powder stays in the box"),
                )
            });
        });
    }
    group.finish();
}

fn both(criterion: &mut Criterion) {
    stages::<f32>(criterion, "f32");
    stages::<f64>(criterion, "f64");
}

criterion_group!(benches, both);
criterion_main!(benches);
