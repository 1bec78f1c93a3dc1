//! What an arm hears on classic CAN: whatever is decoded is encoded into the very frame that completed it.
#![no_main]

use libfuzzer_sys::fuzz_target;
use powderline_fuzz::{CONTEXT, arm, frames, golden, message_seeds, plant};
use powderline_shared::wire::codec::Encoder;
use powderline_shared::wire::frame::Dialect;
use powderline_shared::wire::message::ToArm;

fuzz_target!(init: plant(message_seeds(&golden(Dialect::Classic, "to"))), |bytes: &[u8]| {
    let mut decoder = arm(Dialect::Classic);
    for frame in frames(bytes) {
        for message in decoder.handle_frame(&frame).into_iter().flatten() {
            let mut again = Encoder::new(Dialect::Classic).to_arm(&CONTEXT, &message);
            // A record may have been written in more ways than ours.
            assert!(matches!(message, ToArm::Open(_) | ToArm::OpenKeyed(..)) || again.any(|found| found == frame), "{message:?}");
        }
    }
});
