//! A plan file with anything in it, as it is and with a right beginning and checksum: what is accepted can be played.
#![no_main]

use libfuzzer_sys::fuzz_target;
use powderline_fuzz::{GOLDEN_PLAN, crc32, plant};
use powderline_shared::plan::{FORMAT_VERSION, MAGIC, PlanHeader, PlanReader, PlanWriter};

fuzz_target!(init: plant(seeds()), |bytes: &[u8]| {
    check(bytes);
    let mut sealed = [&MAGIC[..], &FORMAT_VERSION.to_le_bytes(), bytes].concat();
    sealed.extend(crc32(&sealed).to_le_bytes());
    check(&sealed);
});

fn check(bytes: &[u8]) {
    let Ok(plan) = PlanReader::new(bytes) else { return };
    assert_eq!(plan.setpoints().count(), plan.header().step_count as usize);
    assert_eq!(plan.setpoints().last(), Some(plan.end_setpoint()));
    let _ = plan.check_limits();
}

/// The golden plan and one of its first steps, whole and without what the target adds.
fn seeds() -> Vec<Vec<u8>> {
    let whole = PlanReader::new(GOLDEN_PLAN).expect("the golden plan is a plan");
    let mut short = Vec::new();
    let sink = |part: &[u8]| {
        short.extend_from_slice(part);
        Ok::<(), std::convert::Infallible>(())
    };
    let header = PlanHeader { step_count: 3, ..*whole.header() };
    let mut writer = PlanWriter::new(sink, &header).expect("the header is that of a plan");
    for step in whole.steps().take(3) {
        writer.step(step).expect("the steps are those of a plan");
    }
    writer.finish().expect("there are as many steps as promised");
    [GOLDEN_PLAN, &short].iter().flat_map(|plan| [plan.to_vec(), plan[10..plan.len() - 4].to_vec()]).collect()
}
