//! A serial line with anything on it: packets are bounded, survive being encoded again, and the next one is always found.
#![no_main]

use libfuzzer_sys::fuzz_target;
use powderline_fuzz::{golden, plant};
use powderline_shared::wire::cobs::{Decoder, encode};
use powderline_shared::wire::frame::{Dialect, MAX_ID};
use powderline_shared::wire::serial::{LineReader, to_line};

const MAX: usize = 300;

fuzz_target!(init: plant(seeds()), |bytes: &[u8]| {
    let (mut packets, mut frames) = (Decoder::<MAX>::new(), LineReader::new());
    for byte in bytes {
        if let Some(Ok(packet)) = packets.push(*byte) {
            check_again(&packet);
        }
        if let Some(Ok(frame)) = frames.push(*byte) {
            assert!(frame.id <= MAX_ID && frame.data.len() <= Dialect::Fd.max_data());
        }
    }
    // The bytes as a packet, after whatever they left in the reader as a stream.
    let packet = &bytes[..bytes.len().min(MAX)];
    let mut line = [0].into_iter().collect();
    encode::<{ MAX + 8 }>(packet, &mut line).unwrap();
    let found: Vec<_> = line.iter().filter_map(|byte| packets.push(*byte)).collect();
    assert_eq!(found.last().map(|found| found.as_deref()), Some(Ok(packet)));
});

/// The golden frames on a line, each message alone and each way as a whole.
fn seeds() -> impl Iterator<Item = Vec<u8>> {
    ["to", "from"].into_iter().flat_map(|way| {
        let messages = golden(Dialect::Fd, way);
        let whole = messages.concat();
        messages.into_iter().chain([whole]).map(|frames| frames.iter().flat_map(to_line).collect())
    })
}

fn check_again(packet: &[u8]) {
    let mut line = Default::default();
    encode::<{ MAX + 8 }>(packet, &mut line).unwrap();
    let mut decoder = Decoder::<MAX>::new();
    let found: Vec<_> = line.iter().filter_map(|byte| decoder.push(*byte)).collect();
    assert_eq!(found.len(), 1);
    assert_eq!(found[0].as_deref(), Ok(packet));
}
