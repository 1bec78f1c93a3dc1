//! Frames on a serial line that drops and adds bytes.

use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::serial::{LineReader, to_line};
use proptest::prelude::*;

/// The frames on a line, and how many pieces were none.
fn read(reader: &mut LineReader, line: &[u8]) -> (Vec<Frame>, usize) {
    let found: Vec<_> = line.iter().filter_map(|byte| reader.push(*byte)).collect();
    let garbled = found.iter().filter(|piece| piece.is_err()).count();
    (found.into_iter().flatten().collect(), garbled)
}

#[test]
fn a_truncated_frame_is_dropped_and_the_next_one_found() {
    let first = to_line(&Frame::new(0x181, &[1, 2, 0, 4]).unwrap());
    let second = Frame::new(0x281, &[9; 48]).unwrap();
    for cut in 1..first.len() - 1 {
        // The zero that ends the truncated piece is the one that a line sends when it is opened.
        let line = [&first[..cut], &[0], &to_line(&second)].concat();
        let (frames, garbled) = read(&mut LineReader::new(), &line);
        assert_eq!(frames.last(), Some(&second), "cut after {cut}");
        // Where a block ends, the piece is a shorter frame, which the messages' own checksums refuse.
        assert_eq!(frames.len() + garbled, 2, "cut after {cut}: {frames:?}");
    }
}

#[test]
fn a_piece_that_is_no_frame_is_told_from_an_empty_one() {
    let mut reader = LineReader::new();
    assert_eq!(read(&mut reader, &[0, 0, 0]), (vec![], 0), "several delimiters are as good as one");
    for piece in [&[0xFF; 300][..], &[3, 0xFF, 0xFF], &[2, 1], &[1], &[9, 1]] {
        assert_eq!(read(&mut reader, &[piece, &[0]].concat()), (vec![], 1), "{piece:?}");
    }
    let good = Frame::new(0x701, &[5]).unwrap();
    assert_eq!(read(&mut reader, &to_line(&good)), (vec![good], 0));
}

fn frames() -> impl Strategy<Value = Frame> {
    let byte = prop_oneof![Just(0_u8), any::<u8>()];
    (0..0x800_u16, prop::collection::vec(byte, 0..=Dialect::Fd.max_data()))
        .prop_map(|(id, data)| Frame::new(id, &data).unwrap())
}

proptest! {
    #[test]
    fn every_frame_comes_back_after_any_garbage(
        garbage in prop::collection::vec(any::<u8>(), 0..100), sent in prop::collection::vec(frames(), 1..5),
    ) {
        let mut reader = LineReader::new();
        read(&mut reader, &[&garbage[..], &[0]].concat());
        for frame in sent {
            prop_assert_eq!(read(&mut reader, &to_line(&frame)), (vec![frame], 0));
        }
    }
}
