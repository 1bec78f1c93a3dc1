//! The text of an executed motion from outside: pinned lines, round trips, and what is refused with which words.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use powderline_shared::pose::Pose;
use powderline_shared::trajectory::{
    MAX_LINE_BYTES, MAX_TICK, Sample, TrajectoryError, TrajectoryHeader, TrajectoryReader,
};
use proptest::prelude::*;

const HEADER: TrajectoryHeader = TrajectoryHeader { plan_hash: 0x0123_4567_89ab_cdef, period_us: 10_000 };

fn pose(position_m: [f64; 3], [w, x, y, z]: [f64; 4]) -> Pose {
    Pose {
        position_m: Vector3::from(position_m),
        orientation: UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)),
    }
}

fn text(header: TrajectoryHeader, samples: &[Sample]) -> String {
    samples.iter().fold(format!("{header}\n"), |text, sample| format!("{text}{sample}\n"))
}

fn read(text: &[u8]) -> Result<(TrajectoryHeader, Vec<Sample>), TrajectoryError> {
    let mut reader = TrajectoryReader::default();
    let mut samples = Vec::new();
    for line in text.split_inclusive(|byte| *byte == b'\n') {
        samples.extend(reader.line(line)?);
    }
    Ok((reader.finish()?, samples))
}

fn bits(sample: &Sample) -> (u32, [u64; 3], [u64; 4]) {
    let q = sample.pose.orientation;
    let position: [f64; 3] = sample.pose.position_m.into();
    (sample.tick, position.map(f64::to_bits), [q.w, q.i, q.j, q.k].map(f64::to_bits))
}

const PINNED: &str = "powderline-executed 1\n\
    plan 0123456789abcdef\n\
    period_us 10000\n\
    0 0.1 -0.0 3e-17 1.0 0.0 0.0 0.0\n\
    1 0.30000000000000004 1e22 5e-324 -0.5 0.5 -0.5 0.5\n";

#[test]
fn the_text_is_pinned() {
    let samples = [
        Sample { tick: 0, pose: pose([0.1, -0.0, 3e-17], [1.0, 0.0, 0.0, 0.0]) },
        Sample { tick: 1, pose: pose([0.1 + 0.2, 1e22, 5e-324], [-0.5, 0.5, -0.5, 0.5]) },
    ];
    assert_eq!(text(HEADER, &samples), PINNED);
    let (header, found) = read(PINNED.as_bytes()).unwrap();
    assert_eq!(header, HEADER);
    assert!(found.iter().map(bits).eq(samples.iter().map(bits)));
}

#[test]
fn spaces_and_foreign_line_ends_do_not_matter_nor_does_a_missing_last_one() {
    let sound = read(PINNED.as_bytes()).unwrap();
    for other in [
        PINNED.replace('\n', "\r\n"),
        PINNED.replace(' ', " \t ").replace('\n', " \n"),
        PINNED.trim_end().to_owned(),
        PINNED.replace("abcdef", "ABCDEF"),
    ] {
        assert_eq!(read(other.as_bytes()), Ok(sound.clone()), "{other:?}");
    }
}

#[test]
fn the_header_is_known_before_the_samples() {
    let mut reader = TrajectoryReader::default();
    for (line, known) in PINNED.split_inclusive('\n').zip([false, false, true, true, true]) {
        reader.line(line.as_bytes()).unwrap();
        assert_eq!(reader.header(), known.then_some(HEADER), "{line}");
    }
}

/// The pinned text with one line in place of another.
fn with_line(number: usize, line: &str) -> String {
    let lines = PINNED.lines().enumerate();
    lines.map(|(k, old)| format!("{}\n", if k + 1 == number { line } else { old })).collect()
}

#[test]
fn every_malformed_line_is_refused_in_words_that_say_where_and_what() {
    let long = " ".repeat(MAX_LINE_BYTES + 1);
    let cases = [
        (1, "", "it begins with ``, but an executed motion begins with `powderline-executed`"),
        (1, "PWDLPLAN\u{1}", "it begins with `PWDLPLAN\\x01`, but"),
        (1, &"a".repeat(1_000), "it begins with `aaaaaaaaaaaaaaaaaaaaaaaa..`, but"),
        (1, "powderline-executed", "its line 1 ends where its version should stand"),
        (1, "powderline-executed one", "in line 1 the version is `one`, but must be a whole number"),
        (1, "powderline-executed 2", "it has format version 2, but this program reads version 1"),
        (1, "powderline-executed 1 1", "its line 1 goes on with `1`, but should be at its end"),
        (1, &format!("powderline-executed 1{long}"), "its line 1 is longer than 256 bytes"),
        (2, "", "its line 2 begins with ``, but must begin with `plan`"),
        (2, "period_us 10000", "its line 2 begins with `period_us`, but must begin with `plan`"),
        (2, "plan", "its line 2 ends where its content hash should stand"),
        (2, "plan 123", "in line 2 the content hash is `123`, but must be 16 hexadecimal digits"),
        (2, "plan +123456789abcdef", "in line 2 the content hash is `+123456789abcdef`, but must be"),
        (2, "plan 0123456789abcdefg", "the content hash is `0123456789abcdefg`"),
        (2, "plan \u{e9}123456789abcde", "the content hash is `\\xc3\\xa9123456789abcde`"),
        (2, "plan 0123456789abcdef x", "its line 2 goes on with `x`"),
        (3, "0 0 0 0 1 0 0 0", "its line 3 begins with `0`, but must begin with `period_us`"),
        (3, "period_us", "its line 3 ends where its period should stand"),
        (3, "period_us 1e4", "in line 3 the period is `1e4`, but must be a whole number of microseconds"),
        (3, "period_us 99", "its period is 99 us, but must lie between 100 and 100000 us"),
        (3, "period_us 100001", "its period is 100001 us, but"),
        (3, "period_us 10000 us", "its line 3 goes on with `us`"),
        (4, "", "its line 4 ends where its tick should stand"),
        (4, "zero 0 0 0 1 0 0 0", "in line 4 the tick is `zero`, but must be a whole number"),
        (4, "-1 0 0 0 1 0 0 0", "in line 4 the tick is `-1`, but must be a whole number"),
        (4, "4294967296 0 0 0 1 0 0 0", "in line 4 the tick is `4294967296`, but"),
        (4, "1 0 0 0 1 0 0 0", "in line 4 the tick is 1, but the first sample must be that of tick 0"),
        (5, "0 0 0 0 1 0 0 0", "in line 5 the tick is 0, but tick 1 must follow tick 0"),
        (5, "3 0 0 0 1 0 0 0", "in line 5 the tick is 3, but tick 1 must follow tick 0"),
        (5, "1", "its line 5 ends where its x should stand"),
        (5, "1 0 0 0 1 0 0", "its line 5 ends where its qz should stand"),
        (5, "1 0 0 0 1 0 0 0 0.5", "its line 5 goes on with `0.5`"),
        (5, "1 0 0,5 0 1 0 0 0", "in line 5 the y is `0,5`, but must be a decimal number"),
        (5, "1 0 0 0x1 1 0 0 0", "in line 5 the z is `0x1`, but"),
        (5, "1 NaN 0 0 1 0 0 0", "in line 5 x is `NaN`, but must be a finite number"),
        (5, "1 0 0 -inf 1 0 0 0", "in line 5 z is `-inf`, but"),
        (5, "1 0 0 1e309 1 0 0 0", "in line 5 z is `1e309`, but"),
        (5, "1 0 0 0 1 0 infinity 0", "in line 5 qy is `infinity`, but"),
        (5, "1 0 0 0 0 0 0 0", "in line 5 the quaternion has a norm of 0.0, but must have norm 1"),
        (5, "1 0 0 0 1 0 0.0001 0", "the quaternion has a norm of 1.000000005"),
        (5, "1 0 0 0 1e200 0 0 0", "the quaternion has a norm of inf, but"),
        (5, &format!("1{long}"), "its line 5 is longer than 256 bytes"),
    ];
    for (number, line, about) in cases {
        let error = read(with_line(number, line).as_bytes()).expect_err(line).to_string();
        assert!(error.contains(about), "`{about}` in `{error}` for `{line}`");
    }
    let mut broken = PINNED.as_bytes().to_vec();
    broken.extend(b"2 \xff 0 0 1 0 0 0");
    let error = read(&broken).unwrap_err().to_string();
    assert!(error.contains("in line 6 the x is `\\xff`, but must be a decimal number"), "{error}");
}

#[test]
fn a_file_that_ends_before_the_first_sample_is_refused() {
    let lines: Vec<_> = PINNED.split_inclusive('\n').collect();
    for (count, about) in [
        (0, "it is empty, but its first line must be `powderline-executed 1`"),
        (1, "it ends after line 1, where the plan's content hash must follow"),
        (2, "it ends after line 2, where the control period must follow"),
        (3, "it ends after line 3, where the sample of tick 0 must follow"),
    ] {
        assert_eq!(read(lines[..count].concat().as_bytes()).unwrap_err().to_string(), about);
    }
    assert_eq!(read(lines[..4].concat().as_bytes()).unwrap().1.len(), 1);
}

#[test]
fn a_line_after_one_that_was_refused_is_read_as_if_that_had_not_been() {
    let mut reader = TrajectoryReader::default();
    let mut lines = PINNED.split_inclusive('\n');
    for line in lines.by_ref().take(4) {
        reader.line(line.as_bytes()).unwrap();
    }
    assert!(reader.line(b"1 0 0 0 1 0 0 nonsense").is_err());
    assert_eq!(reader.line(lines.next().unwrap().as_bytes()).unwrap().map(|sample| sample.tick), Some(1));
}

#[test]
fn no_motion_is_longer_than_the_longest_plan_and_the_way_to_rest() {
    let mut reader = TrajectoryReader::default();
    for line in PINNED.lines().take(3) {
        reader.line(line.as_bytes()).unwrap();
    }
    for tick in 0..=MAX_TICK {
        assert!(matches!(reader.line(format!("{tick} 0 0 0 1 0 0 0").as_bytes()), Ok(Some(_))), "{tick}");
    }
    let line = MAX_TICK + 5;
    let surplus = format!("{} 0 0 0 1 0 0 0", MAX_TICK + 1);
    assert_eq!(reader.line(surplus.as_bytes()), Err(TrajectoryError::TooLong { line }));
}

fn any_finite() -> impl Strategy<Value = f64> {
    any::<u64>().prop_map(f64::from_bits).prop_filter("finite", |value| value.is_finite())
}

fn any_pose() -> impl Strategy<Value = Pose> {
    let component = || -1.0..1.0_f64;
    let quaternion = [component(), component(), component(), component()]
        .prop_filter("a direction", |q| q.iter().map(|x| x * x).sum::<f64>() > 0.01);
    ([any_finite(), any_finite(), any_finite()], quaternion).prop_map(|(position_m, q)| {
        let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        pose(position_m, q.map(|x| x / norm))
    })
}

proptest! {
    #[test]
    fn every_bit_survives(
        plan_hash: u64,
        period_us in 100..=100_000_u32,
        poses in prop::collection::vec(any_pose(), 1..20),
    ) {
        let header = TrajectoryHeader { plan_hash, period_us };
        let samples: Vec<_> = (0..).zip(poses).map(|(tick, pose)| Sample { tick, pose }).collect();
        let text = text(header, &samples);
        prop_assert!(text.lines().all(|line| line.len() <= MAX_LINE_BYTES));
        let (found_header, found) = read(text.as_bytes()).unwrap();
        prop_assert_eq!(found_header, header);
        prop_assert!(found.iter().map(bits).eq(samples.iter().map(bits)));
    }

    /// No bytes make the reader panic, and a damaged file is either refused or one that could have been written.
    #[test]
    fn damage_is_refused_or_harmless(at in 0..PINNED.len(), byte: u8, tail in prop::collection::vec(any::<u8>(), 0..300)) {
        let mut damaged = PINNED.as_bytes().to_vec();
        damaged[at] = byte;
        if let Ok((header, samples)) = read(&damaged) {
            let written = text(header, &samples);
            prop_assert_eq!(read(written.as_bytes()), Ok((header, samples)));
        }
        damaged.truncate(at);
        damaged.extend(tail);
        if let Err(error) = read(&damaged) {
            prop_assert!(!error.to_string().contains(char::is_control));
        }
    }
}
