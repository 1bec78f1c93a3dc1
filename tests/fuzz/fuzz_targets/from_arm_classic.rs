//! What an executor hears on classic CAN: whatever is decoded is encoded into the very frame that completed it.
#![no_main]

use libfuzzer_sys::fuzz_target;
use powderline_fuzz::{CONTEXT, executor, frames, golden, message_seeds, plant};
use powderline_shared::displacement::Setpoint;
use powderline_shared::wire::codec::Encoder;
use powderline_shared::wire::frame::Dialect;
use powderline_shared::wire::message::FromArm;

fuzz_target!(init: plant(message_seeds(&golden(Dialect::Classic, "from"))), |bytes: &[u8]| {
    let mut decoder = executor(Dialect::Classic);
    for (tick, frame) in (0..).step_by(5).zip(frames(bytes)) {
        decoder.expect(Setpoint { tick, counts: [1_000; 6] });
        for message in decoder.handle_frame(&frame).into_iter().flatten() {
            let mut again = Encoder::new(Dialect::Classic).from_arm(&CONTEXT, &message);
            let record = matches!(
                message,
                FromArm::Opened { .. }
                    | FromArm::OpenedKeyed { .. }
                    | FromArm::Refused { .. }
                    | FromArm::Anchored { .. }
            );
            // A record may have been written in more ways than ours.
            assert!(record || again.any(|found| found == frame), "{message:?}");
        }
    }
});
