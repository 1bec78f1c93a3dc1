//! Plans that are none: each command that reads plans refuses them in one sentence with its exit code.

use std::fs::File;
use std::process::Command;

use powderline_shared::plan::{Crc32, FORMAT_VERSION};

use crate::programs::{EXECUTE, FIRMWARE_SIM, OPTIMISE, Place, bytes, run};

/// A plan of a later format version, with the checksum that fits.
fn from_the_future(plan: &[u8]) -> Vec<u8> {
    let mut plan = plan[..plan.len() - 4].to_vec();
    plan[8..10].copy_from_slice(&(FORMAT_VERSION + 1).to_le_bytes());
    let mut checksum = Crc32::default();
    checksum.update(&plan);
    plan.extend(checksum.value().to_le_bytes());
    plan
}

#[test]
fn a_damaged_plan_is_refused_by_every_command_that_reads_plans() {
    let place = Place::new();
    let sound = bytes(place.tiny_run("run", 0), "skill.plan");
    let flipped = |bit: usize| {
        let mut plan = sound.clone();
        plan[bit / 8] ^= 1 << (bit % 8);
        plan
    };
    let cases = [
        ("empty", Vec::new(), "empty"),
        ("header-only", sound[..200].to_vec(), "checksum"),
        ("a-byte-short", sound[..sound.len() - 1].to_vec(), "checksum"),
        ("a-byte-long", [&sound[..], b"\n"].concat(), "checksum"),
        ("flipped-in-the-header", flipped(8 * 40), "checksum"),
        ("flipped-in-a-step", flipped(8 * (sound.len() - 99) + 3), "checksum"),
        ("flipped-in-the-checksum", flipped(8 * sound.len() - 1), "checksum"),
        ("from-the-future", from_the_future(&sound), &format!("version {FORMAT_VERSION}")),
        ("text", b"a plan\n".repeat(100), "begins with"),
    ];
    for (name, plan, about) in cases {
        let path = place.write(&format!("{name}.plan"), &plan);
        run(EXECUTE, &[&path]).refused(3, about);
        let about = if plan.is_empty() { "0 bytes" } else { about };
        run(OPTIMISE, &["inspect", &path]).refused(2, about);
        run(OPTIMISE, &["simulate", &place.tiny(), "--plan", &path]).refused(2, about);
    }
}

/// A pipe that nobody writes to would be waited for without end; what is no regular file is refused unread.
#[test]
#[cfg(unix)]
fn no_program_waits_for_a_plan_that_never_comes() {
    let place = Place::new();
    let pipe = place.path("pipe.plan");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let huge = place.path("huge.plan");
    File::create(&huge).unwrap().set_len(1 << 32).unwrap();
    for (path, about) in
        [(pipe.as_str(), "not a regular file"), ("/dev/zero", "not a regular file"), (&huge, "at most")]
    {
        run(EXECUTE, &[path]).refused(3, about);
        run(FIRMWARE_SIM, &["--on", "pty", "--at", path]).refused(1, about);
        run(OPTIMISE, &["inspect", path]).refused(2, about);
        run(OPTIMISE, &["export", "--format", "csv", path]).refused(2, about);
        run(OPTIMISE, &["report", path]).refused(2, about);
        for command in ["simulate", "render"] {
            run(OPTIMISE, &[command, "--plan", path]).refused(2, about);
        }
    }
}
