//! What both ends hear on CAN FD and on a serial line: whatever is decoded survives being encoded and decoded again.
#![no_main]

use libfuzzer_sys::fuzz_target;
use powderline_fuzz::{CONTEXT, arm, executor, frames, golden, message_seeds, plant, sealed_fd};
use powderline_shared::wire::codec::Encoder;
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::serial::{LineReader, to_line};

fn seeds() -> impl Iterator<Item = Vec<u8>> {
    ["to", "from"].into_iter().flat_map(|way| message_seeds(&golden(Dialect::Fd, way)))
}

/// A frame as it comes out of a serial line.
fn over_a_line(frame: &Frame) -> Frame {
    let mut reader = LineReader::new();
    let read: Vec<_> = to_line(frame).iter().filter_map(|byte| reader.push(*byte)).collect();
    assert_eq!(read, [Ok(frame.clone())]);
    read.into_iter().flatten().next().unwrap()
}

/// Whether some frames say this again; messages with not-a-number in them are compared as text.
fn says<M: std::fmt::Debug>(heard: impl Iterator<Item = M>, message: &M) -> bool {
    heard.map(|found| format!("{found:?}")).any(|found| found == format!("{message:?}"))
}

fuzz_target!(init: plant(seeds()), |bytes: &[u8]| {
    let (mut arm_hears, mut executor_hears) = (arm(Dialect::Fd), executor(Dialect::Fd));
    for frame in frames(bytes) {
        for frame in [sealed_fd(&frame), over_a_line(&frame)] {
            for message in arm_hears.handle_frame(&frame).into_iter().flatten() {
                let mut decoder = arm(Dialect::Fd);
                let again = Encoder::new(Dialect::Fd).to_arm(&CONTEXT, &message);
                assert!(says(again.flat_map(|frame| decoder.handle_frame(&frame).unwrap()), &message));
            }
            for message in executor_hears.handle_frame(&frame).into_iter().flatten() {
                let mut decoder = executor(Dialect::Fd);
                let again = Encoder::new(Dialect::Fd).from_arm(&CONTEXT, &message);
                assert!(says(again.flat_map(|frame| decoder.handle_frame(&frame).unwrap()), &message));
            }
        }
    }
});
