//! Serial lines and pseudo-terminals, joined to each other.
#![expect(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::fs::{File, OpenOptions};
use std::io::Write;
use std::path::Path;

use powderline_host::clock;
use powderline_host::transport::{Incoming, LinkError, MAX_QUEUED, Pty, Sent, Serial, Transport};
use powderline_host::wait::wait_until;
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::serial::{MAX_LINE_BYTES, to_line};

/// What has not come by then does not come, microseconds.
const PATIENCE_US: u64 = 2_000_000;
/// What is never to come is waited for so long, microseconds.
const QUIET_US: u64 = 50_000;

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame { id, data: heapless::Vec::from_slice(data).unwrap() }
}

fn next_within(wire: &mut dyn Transport, patience_us: u64) -> Option<Frame> {
    let deadline_us = clock::now_us() + patience_us;
    loop {
        if let Some(received) = wire.receive().unwrap() {
            assert!(received.at_us <= clock::now_us());
            let Incoming::Frame(frame) = received.what else {
                panic!("a line has no controller: {received:?}")
            };
            return Some(frame);
        }
        let look_again_us = deadline_us.min(clock::now_us() + 10_000);
        wait_until(Some(look_again_us), [wire.interest()]).unwrap();
        if clock::now_us() >= deadline_us {
            return None;
        }
    }
}

fn next(wire: &mut dyn Transport) -> Frame {
    next_within(wire, PATIENCE_US).expect("a frame arrives")
}

fn joined() -> (Pty, Serial) {
    let pty = Pty::create().unwrap();
    let serial = Serial::open(pty.path(), 115_200).unwrap();
    (pty, serial)
}

/// Writes bytes as they are, as another program's faulty line would.
fn scribble(path: &Path, bytes: &[u8]) {
    let mut line = OpenOptions::new().write(true).open(path).unwrap();
    line.write_all(bytes).unwrap();
}

#[test]
fn frames_pass_both_ways_with_every_byte() {
    let (mut pty, mut serial) = joined();
    assert_eq!((pty.dialect(), serial.dialect()), (Dialect::Fd, Dialect::Fd));
    let all: Vec<u8> = (0..=u8::MAX).collect();
    for (id, data) in [0x001, 0x201, 0x401, 0x7FF].into_iter().zip(all.chunks(64)) {
        let sent = frame(id, data);
        assert_eq!(serial.send(&sent).unwrap(), Sent::Done);
        assert_eq!(next(&mut pty), sent);
        assert_eq!(pty.send(&sent).unwrap(), Sent::Done);
        assert_eq!(next(&mut serial), sent);
    }
    assert_eq!((pty.garbled(), serial.garbled()), (0, 0));
}

#[test]
fn garbage_is_counted_and_the_next_frame_is_found() {
    let (mut pty, mut serial) = joined();
    scribble(pty.path(), &[[0x55; 500].as_slice(), &[0, 1, 0]].concat());
    let sent = frame(0x201, &[7; 48]);
    serial.send(&sent).unwrap();
    assert_eq!(next(&mut pty), sent);
    assert_eq!(pty.garbled(), 2);
}

#[test]
fn a_truncated_frame_costs_one_frame_at_most() {
    let (mut pty, mut serial) = joined();
    let lost = to_line(&frame(0x181, &[1; 20]));
    scribble(pty.path(), &lost[..lost.len() - 5]);
    let swallowed = frame(0x701, &[2; 16]);
    let sent = frame(0x281, &[3; 48]);
    serial.send(&swallowed).unwrap();
    serial.send(&sent).unwrap();
    assert_eq!(next(&mut pty), sent, "what was joined to the truncated frame is no frame");
    assert_eq!(pty.garbled(), 1);
}

#[test]
fn a_slave_may_close_in_mid_frame_and_another_may_open() {
    let (mut pty, serial) = joined();
    let unfinished = to_line(&frame(0x181, &[1; 20]));
    scribble(pty.path(), &unfinished[..9]);
    drop(serial);
    assert_eq!(next_within(&mut pty, QUIET_US), None);
    assert!(!pty.is_open() && pty.interest().is_none());
    // Nobody listens: nothing fills up, and nothing of it meets the next program.
    for _ in 0..10_000 {
        assert_eq!(pty.send(&frame(0x181, &[9; 48])).unwrap(), Sent::Done);
    }
    for round in 0..3 {
        let mut serial = Serial::open(pty.path(), 921_600).unwrap();
        assert!(pty.is_open() && pty.interest().is_some());
        let sent = frame(0x401, &[round; 16]);
        serial.send(&sent).unwrap();
        assert_eq!(next(&mut pty), sent, "round {round}");
        pty.send(&sent).unwrap();
        assert_eq!(next(&mut serial), sent, "round {round}");
    }
    assert_eq!(pty.garbled(), 0);
}

#[test]
fn a_slave_that_is_not_opened_by_us_needs_no_settings() {
    let mut pty = Pty::create().unwrap();
    assert_eq!(next_within(&mut pty, QUIET_US), None, "before anybody has opened it");
    let mut line = OpenOptions::new().read(true).write(true).open(pty.path()).unwrap();
    let sent = frame(0x20A, &[0x0A, 0x0D, 0x03, 0x11, 0x13, 0x1A, 0x7F, 0x04]);
    line.write_all(&to_line(&sent)).unwrap();
    assert_eq!(next(&mut pty), sent, "control characters are data");
    assert_eq!(next_within(&mut pty, QUIET_US), None, "nothing is echoed");
}

#[test]
fn a_line_that_is_not_read_is_busy_and_never_waits() {
    let (mut pty, mut serial) = joined();
    let sent: Vec<Frame> = (0..3000_u16).map(|i| frame(i % 0x7FF, &[i.to_le_bytes()[0]; 64])).collect();
    let begin_us = clock::now_us();
    let taken = sent.iter().take_while(|frame| pty.send(frame).unwrap() == Sent::Done).count();
    assert!(taken > 0 && taken < sent.len(), "{taken} frames taken");
    assert_eq!(pty.send(&sent[0]).unwrap(), Sent::Busy);
    assert!(clock::now_us() - begin_us < PATIENCE_US);
    assert!(pty.interest().unwrap().writable, "what is left of a frame is waited for");
    // Everything that was taken arrives, in order, and then the line is free.
    for expected in &sent[..taken] {
        assert_eq!(pty.receive().unwrap(), None);
        assert_eq!(&next(&mut serial), expected);
    }
    assert_eq!(next_within(&mut serial, QUIET_US), None);
    assert_eq!(pty.send(&sent[0]).unwrap(), Sent::Done);
    assert_eq!(next(&mut serial), sent[0]);
    assert!(MAX_QUEUED < sent.len() * MAX_LINE_BYTES);
}

#[test]
fn a_device_that_goes_away_is_gone() {
    let (pty, mut serial) = joined();
    let name = pty.path().display().to_string();
    drop(pty);
    let error = serial.receive().unwrap_err();
    assert!(matches!(error, LinkError::Gone { .. }), "{error}");
    assert!(error.to_string().contains(&format!("{name} is gone")), "{error}");
    assert!(matches!(serial.send(&frame(1, b"STOP")), Err(LinkError::Gone { .. })));
}

#[test]
fn a_device_is_opened_by_one_program_alone() {
    let (pty, serial) = joined();
    let error = Serial::open(pty.path(), 115_200).unwrap_err();
    assert!(matches!(error, LinkError::InUse { .. }), "{error}");
    drop(serial);
    Serial::open(pty.path(), 115_200).unwrap();
}

#[test]
fn what_is_no_line_is_refused_in_one_sentence() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("file");
    File::create(&file).unwrap();
    for (path, words) in [
        (Path::new("/dev/ttyNONE9"), "there is no device /dev/ttyNONE9"),
        (&file, "is no serial line"),
        (Path::new("/dev/null"), "/dev/null is no serial line"),
        (dir.path(), "is no serial line"),
    ] {
        let error = Serial::open(path, 115_200).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
        assert!(!error.contains('\n'));
    }
}
