//! A plan file with anything in it, as it is and with a right beginning and checksum: what is accepted can be played.
#![no_main]

use libfuzzer_sys::fuzz_target;
use powderline_fuzz::crc32;
use powderline_shared::plan::{FORMAT_VERSION, MAGIC, PlanReader};

fuzz_target!(|bytes: &[u8]| {
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
