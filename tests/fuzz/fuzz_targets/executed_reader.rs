//! An executed motion with anything in it, as it is and behind a right header: what is accepted is written and read again
//! to the same bits.
#![no_main]

use libfuzzer_sys::fuzz_target;
use powderline_fuzz::{assert_sentence, plant};
use powderline_shared::trajectory::{Sample, TrajectoryError, TrajectoryHeader, TrajectoryReader};

const HEADER: TrajectoryHeader = TrajectoryHeader { plan_hash: 0x0123_4567_89ab_cdef, period_us: 10_000 };

fuzz_target!(init: plant(seeds()), |bytes: &[u8]| {
    check(bytes);
    check(&[HEADER.to_string().as_bytes(), b"\n", bytes].concat());
});

fn check(text: &[u8]) {
    match read(text) {
        Err(error) => assert_sentence(&error),
        Ok((header, samples)) => {
            let lines = samples.iter().map(|sample| format!("\n{sample}"));
            let again = header.to_string() + &lines.collect::<String>();
            let found = read(again.as_bytes()).expect("what is written can be read");
            assert_eq!(format!("{:?}", (header, samples)), format!("{found:?}"));
        }
    }
}

fn read(text: &[u8]) -> Result<(TrajectoryHeader, Vec<Sample>), TrajectoryError> {
    let (mut reader, mut samples) = (TrajectoryReader::default(), Vec::new());
    for line in text.split_inclusive(|byte| *byte == b'\n') {
        samples.extend(reader.line(line)?);
    }
    Ok((reader.finish()?, samples))
}

fn seeds() -> [Vec<u8>; 3] {
    let samples =
        "0 0.038 -0.0 3e-17 1.0 0.0 0.0 0.0\n1 1e22 5e-324 -7 -0.5 0.5 -0.5 0.5\n2 0 0 .5 0 .6 -.8 0\n";
    [format!("{HEADER}\n{samples}"), samples.into(), samples.replace('\n', " \r\n")].map(String::into_bytes)
}
