//! Bytes that must never change under one version of the protocol.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use powderline_shared::wire::codec::Encoder;
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::message::PROTOCOL_VERSION;

use crate::samples::{self, CONTEXT};

const CLASSIC: &str = include_str!("../golden/wire-v3-classic.txt");
const FD: &str = include_str!("../golden/wire-v3-fd.txt");

pub(crate) fn file(dialect: Dialect) -> &'static str {
    match dialect {
        Dialect::Classic => CLASSIC,
        Dialect::Fd => FD,
    }
}

/// A frame as candump writes it.
fn candump(dialect: Dialect, frame: &Frame) -> String {
    let hex: String = frame.data.iter().map(|byte| format!("{byte:02X}")).collect();
    let separator = if dialect == Dialect::Classic { "#" } else { "##1" };
    format!("{:03X}{separator}{hex}", frame.id)
}

fn section(text: &mut String, dialect: Dialect, name: &str, frames: impl Iterator<Item = Frame>) {
    writeln!(text, "\n# {name}").unwrap();
    for frame in frames {
        writeln!(text, "{}", candump(dialect, &frame)).unwrap();
    }
}

fn written(dialect: Dialect) -> String {
    let mut text = format!(
        "# Frames of protocol version {PROTOCOL_VERSION}, {dialect:?}; session {:#06x}, seal {:#018x}.\n",
        CONTEXT.session, CONTEXT.seal
    );
    let mut encoder = Encoder::new(dialect);
    for (name, message) in samples::to_arm(dialect) {
        section(&mut text, dialect, &format!("to arm: {name}"), encoder.to_arm(&CONTEXT, &message));
    }
    for (name, message) in samples::from_arm() {
        section(&mut text, dialect, &format!("from arm: {name}"), encoder.from_arm(&CONTEXT, &message));
    }
    text
}

#[test]
fn bytes_are_pinned() {
    for dialect in Dialect::ALL {
        let (written, pinned) = (written(dialect), file(dialect));
        if written != pinned {
            let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("wire-{dialect:?}.txt"));
            fs::write(&path, written).unwrap();
            panic!(
                "a change of bytes needs a new protocol version; what is written now is in {}",
                path.display()
            );
        }
    }
}
