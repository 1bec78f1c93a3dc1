//! Bytes that must never change under one version of the protocol.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use powderline_shared::wire::Context;
use powderline_shared::wire::codec::Encoder;
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::message::{FromArm, PROTOCOL_VERSION, ToArm};

use crate::samples::{self, CONTEXT};

const CLASSIC: &str = include_str!("../golden/wire-v3-classic.txt");
const FD: &str = include_str!("../golden/wire-v3-fd.txt");
const CLASSIC_KEYED: &str = include_str!("../golden/wire-v3-classic-key.txt");
const FD_KEYED: &str = include_str!("../golden/wire-v3-fd-key.txt");

/// What is pinned: without a key, and with one.
pub(crate) fn files(dialect: Dialect) -> [&'static str; 2] {
    match dialect {
        Dialect::Classic => [CLASSIC, CLASSIC_KEYED],
        Dialect::Fd => [FD, FD_KEYED],
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
    let first = format!(
        "# Frames of protocol version {PROTOCOL_VERSION}, {dialect:?}; session {:#06x}, seal {:#018x}.\n",
        CONTEXT.session, CONTEXT.seal
    );
    sections(first, dialect, &CONTEXT, samples::to_arm(dialect), samples::from_arm())
}

fn written_keyed(dialect: Dialect) -> String {
    let first = format!(
        "# Frames of protocol version {PROTOCOL_VERSION}, {dialect:?}, with the key 00 01 .. 1F; session {:#06x}.\n",
        CONTEXT.session
    );
    let to_arm = samples::to_arm_keyed(dialect);
    sections(first, dialect, &samples::keyed(), to_arm, samples::from_arm_keyed())
}

fn sections(
    mut text: String,
    dialect: Dialect,
    context: &Context,
    to_arm: Vec<(String, ToArm)>,
    from_arm: Vec<(String, FromArm)>,
) -> String {
    let mut encoder = Encoder::new(dialect);
    for (name, message) in to_arm {
        section(&mut text, dialect, &format!("to arm: {name}"), encoder.to_arm(context, &message));
    }
    for (name, message) in from_arm {
        section(&mut text, dialect, &format!("from arm: {name}"), encoder.from_arm(context, &message));
    }
    text
}

#[test]
fn bytes_are_pinned() {
    for dialect in Dialect::ALL {
        let written = [("", written(dialect)), ("-key", written_keyed(dialect))];
        for ((which, written), pinned) in written.into_iter().zip(files(dialect)) {
            if written != pinned {
                let path =
                    Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("wire-{dialect:?}{which}.txt"));
                fs::write(&path, written).unwrap();
                panic!(
                    "a change of bytes needs a new protocol version; what is written now is in {}",
                    path.display()
                );
            }
        }
    }
}
