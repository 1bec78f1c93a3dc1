//! Real CAN sockets. These need a kernel with CAN, an interface vcan0 and the right to change it, in a machine that is
//! theirs alone: the runner of the vcan tests starts them with `--ignored --test-threads=1`. Without CAN they fail. Two of
//! them need more than vcan: the modules vxcan and sch_tbf, and the module slcan with `ldattach` of util-linux.
#![expect(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::process::{Command, Stdio};

use powderline_host::clock;
use powderline_host::interface::Interface;
use powderline_host::transport::{BusEvent, Incoming, LinkError, Received, Sent, SocketCan, Transport};
use powderline_host::wait::wait_until;
use powderline_shared::wire::frame::{Dialect, Frame};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use socketcan::{
    CanAnyFrame, CanErrorFrame, CanFdSocket, CanFrame, CanRemoteFrame, CanSocket, EmbeddedFrame, ExtendedId,
    Socket, StandardId,
};

/// What has not come by then does not come, microseconds.
const PATIENCE_US: u64 = 2_000_000;

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame { id, data: heapless::Vec::from_slice(data).unwrap() }
}

fn ip(arguments: &str) {
    let status = Command::new("ip").args(arguments.split(' ')).status().unwrap();
    assert!(status.success(), "ip {arguments}");
}

/// A vcan of this test's own, up.
struct Vcan(&'static str);

impl Vcan {
    fn new(name: &'static str, mtu: u32) -> Self {
        ip(&format!("link add dev {name} type vcan"));
        let vcan = Self(name);
        ip(&format!("link set {name} mtu {mtu}"));
        ip(&format!("link set {name} up"));
        vcan
    }
}

impl Drop for Vcan {
    fn drop(&mut self) {
        // A test may have removed it.
        let _ = Command::new("ip").args(["link", "del", self.0]).output();
    }
}

fn next(wire: &mut SocketCan) -> Received {
    let deadline_us = clock::now_us() + PATIENCE_US;
    loop {
        if let Some(received) = wire.receive().unwrap() {
            return received;
        }
        let woken = wait_until(Some(deadline_us), [wire.interest()]).unwrap();
        assert_eq!(woken.late_us, None, "nothing arrives");
    }
}

fn is_quiet(wire: &mut SocketCan) -> bool {
    let until_us = clock::now_us() + 20_000;
    let woken = wait_until(Some(until_us), [wire.interest()]).unwrap();
    woken.late_us.is_some() && wire.receive().unwrap().is_none()
}

#[test]
#[ignore = "needs a kernel with CAN: run by tests/run inside tests/tools/with-vcan"]
fn vcan_frames_pass_both_ways_and_their_own_are_not_received() {
    let vcan = Vcan::new("plcan0", 16);
    let mut here = SocketCan::open(vcan.0, Dialect::Classic).unwrap();
    let mut there = SocketCan::open(vcan.0, Dialect::Classic).unwrap();
    assert_eq!(here.dialect(), Dialect::Classic);
    for (id, data) in [(0x001, b"STOP".as_slice()), (0x201, &[1, 2, 3, 4, 5, 6, 7, 8]), (0x7FF, &[])] {
        let before_us = clock::now_us();
        assert_eq!(here.send(&frame(id, data)).unwrap(), Sent::Done);
        let received = next(&mut there);
        assert_eq!(received.what, Incoming::Frame(frame(id, data)));
        // The kernel's stamp: not before it was sent (to the rounding of the two clocks), not after it was read.
        assert!(
            (before_us.saturating_sub(2_000)..=clock::now_us()).contains(&received.at_us),
            "{before_us} {received:?}"
        );
        assert!(is_quiet(&mut here));
    }
}

#[test]
#[ignore = "needs a kernel with CAN: run by tests/run inside tests/tools/with-vcan"]
fn vcan_the_stamp_is_the_time_of_arrival_not_of_reading() {
    let vcan = Vcan::new("plcan1", 16);
    let mut here = SocketCan::open(vcan.0, Dialect::Classic).unwrap();
    let mut there = SocketCan::open(vcan.0, Dialect::Classic).unwrap();
    here.send(&frame(0x181, &[1])).unwrap();
    let sent_us = clock::now_us();
    wait_until(Some(sent_us + 200_000), [None]).unwrap();
    assert!(next(&mut there).at_us < sent_us + 50_000);
}

#[test]
#[ignore = "needs a kernel with CAN: run by tests/run inside tests/tools/with-vcan"]
fn vcan_fd_carries_64_bytes_and_takes_classic_frames_too() {
    let vcan = Vcan::new("plcan2", 72);
    let mut here = SocketCan::open(vcan.0, Dialect::Fd).unwrap();
    let mut there = SocketCan::open(vcan.0, Dialect::Fd).unwrap();
    let mut classic = SocketCan::open(vcan.0, Dialect::Classic).unwrap();
    assert_eq!(here.dialect(), Dialect::Fd);
    for length in [0, 1, 8, 12, 16, 20, 24, 32, 48, 64] {
        let sent = frame(0x281, &vec![0xA5; length]);
        here.send(&sent).unwrap();
        assert_eq!(next(&mut there).what, Incoming::Frame(sent));
    }
    assert!(is_quiet(&mut classic), "a classic socket sees no frame of CAN FD");
    let stop = frame(0x001, b"STOP");
    classic.send(&stop).unwrap();
    assert_eq!(next(&mut there).what, Incoming::Frame(stop));
    ip("link set plcan2 down");
    ip("link set plcan2 mtu 16");
    ip("link set plcan2 up");
    let error = here.send(&frame(0x281, &[0; 48])).unwrap_err();
    assert!(matches!(error, LinkError::NotFd { .. } | LinkError::Down { .. }), "{error}");
    let error = here.send(&frame(0x281, &[0; 48])).unwrap_err();
    assert!(matches!(error, LinkError::NotFd { .. }), "{error}");
}

#[test]
#[ignore = "needs a kernel with CAN: run by tests/run inside tests/tools/with-vcan"]
fn vcan_what_a_wire_never_carries_is_refused_before_it_is_sent() {
    let vcan = Vcan::new("plcan3", 72);
    let mut classic = SocketCan::open(vcan.0, Dialect::Classic).unwrap();
    let mut fd = SocketCan::open(vcan.0, Dialect::Fd).unwrap();
    let mut there = SocketCan::open(vcan.0, Dialect::Fd).unwrap();
    let refusals = [
        (classic.send(&frame(0x201, &[0; 9])), "0x201 and 9 bytes"),
        (fd.send(&frame(0x201, &[0; 50])), "0x201 and 50 bytes"),
        (fd.send(&frame(0x800, &[0; 8])), "0x800 and 8 bytes"),
    ];
    for (refusal, words) in refusals {
        let error = refusal.unwrap_err();
        assert!(matches!(error, LinkError::Unsendable { .. }), "{error}");
        assert!(error.to_string().contains(words), "{error}");
    }
    assert!(is_quiet(&mut there));
}

#[test]
#[ignore = "needs a kernel with CAN: run by tests/run inside tests/tools/with-vcan"]
fn vcan_extended_and_remote_frames_never_become_frames() {
    let vcan = Vcan::new("plcan4", 72);
    let mut here = SocketCan::open(vcan.0, Dialect::Fd).unwrap();
    let mut classic = SocketCan::open(vcan.0, Dialect::Classic).unwrap();
    let foreign = CanFdSocket::open(vcan.0).unwrap();
    let extended = CanFrame::new(ExtendedId::new(0x201).unwrap(), b"STOP").unwrap();
    let extended_fd = socketcan::CanFdFrame::new(ExtendedId::new(0x1).unwrap(), b"STOP").unwrap();
    let remote = CanRemoteFrame::new_remote(StandardId::new(0x201).unwrap(), 8).unwrap();
    for frame in [CanAnyFrame::from(extended), CanAnyFrame::from(extended_fd), CanAnyFrame::from(remote)] {
        foreign.write_frame(&frame).unwrap();
    }
    foreign
        .write_frame(&CanAnyFrame::from(CanFrame::new(StandardId::new(0x1).unwrap(), b"STOP").unwrap()))
        .unwrap();
    for wire in [&mut here, &mut classic] {
        assert_eq!(next(wire).what, Incoming::Frame(frame(0x001, b"STOP")));
        assert!(is_quiet(wire));
    }
}

#[test]
#[ignore = "needs a kernel with CAN: run by tests/run inside tests/tools/with-vcan"]
fn vcan_error_frames_become_events() {
    let vcan = Vcan::new("plcan5", 16);
    let mut here = SocketCan::open(vcan.0, Dialect::Classic).unwrap();
    // A vcan passes on error frames that are written to it, as a controller's driver raises them.
    let controller = CanSocket::open(vcan.0).unwrap();
    for (class, data, event) in [
        (libc::CAN_ERR_CRTL, [0, 0x08, 0, 0, 0, 0, 0, 0], BusEvent::Warning),
        (libc::CAN_ERR_CRTL, [0, 0x30, 0, 0, 0, 0, 0, 0], BusEvent::ErrorPassive),
        (libc::CAN_ERR_ACK, [0; 8], BusEvent::NoAck),
        (libc::CAN_ERR_BUSOFF, [0; 8], BusEvent::BusOff),
        (libc::CAN_ERR_RESTARTED, [0; 8], BusEvent::Restarted),
    ] {
        let raised = CanErrorFrame::new_error(class, &data).unwrap();
        controller.write_frame(&CanFrame::Error(raised)).unwrap();
        assert_eq!(next(&mut here).what, Incoming::Event(event));
    }
}

#[test]
#[ignore = "needs a kernel with CAN: run by tests/run inside tests/tools/with-vcan"]
fn vcan_an_interface_that_goes_down_says_so_and_works_again_when_it_is_up() {
    let vcan = Vcan::new("plcan6", 16);
    let mut here = SocketCan::open(vcan.0, Dialect::Classic).unwrap();
    let mut there = SocketCan::open(vcan.0, Dialect::Classic).unwrap();
    ip("link set plcan6 down");
    let woken = wait_until(Some(clock::now_us() + PATIENCE_US), [here.interest()]).unwrap();
    assert_eq!(woken.late_us, None, "the socket wakes who waits for it");
    let error = here.receive().unwrap_err();
    assert!(matches!(error, LinkError::Down { .. }), "{error}");
    assert_eq!(error.to_string(), "plcan6 is down: it comes up by `ip link set plcan6 up`");
    assert!(matches!(here.send(&frame(1, b"STOP")), Err(LinkError::Down { .. })));
    assert!(matches!(SocketCan::open(vcan.0, Dialect::Classic), Err(LinkError::Down { .. })));
    ip("link set plcan6 up");
    assert!(
        matches!(there.receive(), Err(LinkError::Down { .. })),
        "that it was down is told to each socket once"
    );
    assert_eq!(here.send(&frame(1, b"STOP")).unwrap(), Sent::Done);
    assert_eq!(next(&mut there).what, Incoming::Frame(frame(1, b"STOP")));
}

#[test]
#[ignore = "needs a kernel with CAN: run by tests/run inside tests/tools/with-vcan"]
fn vcan_an_interface_that_is_removed_is_gone() {
    let vcan = Vcan::new("plcan7", 16);
    let mut here = SocketCan::open(vcan.0, Dialect::Classic).unwrap();
    ip("link del plcan7");
    // Removal takes the interface down first; which of the two is seen depends on how soon one looks.
    assert!(matches!(here.receive(), Err(LinkError::Down { .. } | LinkError::Gone { .. })));
    let error = here.send(&frame(1, b"STOP")).unwrap_err();
    assert!(matches!(error, LinkError::Gone { .. }), "{error}");
    assert!(error.to_string().starts_with("plcan7 is gone"), "{error}");
}

#[test]
#[ignore = "needs a kernel with CAN: run by tests/run inside tests/tools/with-vcan"]
fn vcan_an_interface_that_cannot_be_used_is_refused_in_one_sentence() {
    let vcan = Vcan::new("plcan8", 16);
    for (interface, dialect, words) in [
        ("nocan7", Dialect::Classic, "there is no interface nocan7"),
        ("lo", Dialect::Classic, "lo is no CAN interface"),
        (vcan.0, Dialect::Fd, "plcan8 carries classic frames only: write can:plcan8"),
    ] {
        let error = SocketCan::open(interface, dialect).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}

#[test]
#[ignore = "needs a kernel with CAN: run by tests/run inside tests/tools/with-vcan"]
fn vcan_a_full_queue_is_busy_and_drains() {
    // A pair of virtual interfaces with a queue of ten frames that a token bucket empties at 500 kbit/s, as a bus would.
    ip("link add dev plvx0 type vxcan peer name plvx1");
    let _gone_after = Vcan("plvx0");
    ip("link set plvx0 up");
    ip("link set plvx1 up");
    let limited = Command::new("tc")
        .args("qdisc add dev plvx0 root tbf rate 500kbit burst 32 limit 160".split(' '))
        .status()
        .unwrap();
    assert!(limited.success());
    let mut here = SocketCan::open("plvx0", Dialect::Classic).unwrap();
    let mut there = SocketCan::open("plvx1", Dialect::Classic).unwrap();
    let sent: Vec<Frame> = (0..1000_u16).map(|i| frame(0x201, &i.to_le_bytes())).collect();
    let taken = sent.iter().take_while(|frame| here.send(frame).unwrap() == Sent::Done).count();
    assert!(taken > 0 && taken < sent.len(), "{taken} frames taken");
    for expected in &sent[..taken] {
        assert_eq!(next(&mut there).what, Incoming::Frame(expected.clone()));
    }
    assert_eq!(here.send(&sent[0]).unwrap(), Sent::Done);
}

#[test]
#[ignore = "needs a kernel with CAN: run by tests/run inside tests/tools/with-vcan"]
fn vcan_has_no_bit_rate() {
    let vcan = Vcan::new("plcan9", 72);
    let found = Interface::query(vcan.0).unwrap();
    assert!(found.is_can && found.is_up && found.carries_fd());
    assert_eq!((found.nominal_bit_s, found.data_bit_s), (None, None));
}

/// A CAN controller behind a serial line (Lawicel's protocol), whose far end the test holds: with it the kernel has a true
/// bit rate, and raises true error frames when the line reports the controller's state.
struct Slcan {
    interface: String,
    line: std::fs::File,
    attached: std::process::Child,
}

impl Slcan {
    fn new(bit_s: u32) -> Self {
        let before = interfaces();
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let slave = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
        // 17 is N_SLCAN; in the foreground, so that it ends with the test.
        let attached =
            Command::new("ldattach").args(["-d", "17", &slave]).stderr(Stdio::null()).spawn().unwrap();
        let interface = (0..200)
            .find_map(|_| {
                wait_until(Some(clock::now_us() + 10_000), [None]).unwrap();
                interfaces().difference(&before).next().cloned()
            })
            .expect("ldattach makes an interface");
        ip(&format!("link set {interface} type can bitrate {bit_s}"));
        let mut slcan = Self { interface, line: master.into(), attached };
        slcan.up();
        slcan
    }

    /// Takes the interface up; the kernel waits until its commands to the controller are read.
    fn up(&mut self) {
        let up = ["link", "set", &self.interface, "up"];
        let mut child = Command::new("ip").args(up).spawn().unwrap();
        let mut commands = Vec::new();
        while !commands.ends_with(b"O\r") {
            let mut byte = [0];
            self.line.read_exact(&mut byte).unwrap();
            commands.extend(byte);
        }
        assert!(child.wait().unwrap().success());
        assert!(commands.ends_with(b"C\rS6\rO\r"), "500 kbit/s is speed 6: {commands:?}");
    }

    fn report(&mut self, line: &str) {
        self.line.write_all(format!("{line}\r").as_bytes()).unwrap();
    }
}

impl Drop for Slcan {
    fn drop(&mut self) {
        let _ = self.attached.kill();
        let _ = self.attached.wait();
    }
}

fn interfaces() -> BTreeSet<String> {
    let entries = std::fs::read_dir("/sys/class/net").unwrap();
    entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

#[test]
#[ignore = "needs a kernel with CAN: run by tests/run inside tests/tools/with-vcan"]
fn vcan_a_true_controller_has_a_bit_rate_and_reports_its_state() {
    let mut controller = Slcan::new(500_000);
    let name = controller.interface.clone();
    let found = Interface::query(&name).unwrap();
    assert_eq!((found.nominal_bit_s, found.data_bit_s), (Some(500_000), None));
    assert!(found.agree(&name, Some(500_000), None).is_ok());
    assert!(matches!(found.agree(&name, Some(1_000_000), None), Err(LinkError::OtherRate { .. })));
    let mut here = SocketCan::open(&name, Dialect::Classic).unwrap();
    assert!(matches!(SocketCan::open(&name, Dialect::Fd), Err(LinkError::NotFd { .. })));
    for (report, event) in [
        ("sw100000", BusEvent::Warning),
        ("sp130000", BusEvent::ErrorPassive),
        ("sa000000", BusEvent::ErrorActive),
        ("e1a", BusEvent::NoAck),
        ("e1o", BusEvent::Overflow),
        ("e1B", BusEvent::BusError),
    ] {
        controller.report(report);
        assert_eq!(next(&mut here).what, Incoming::Event(event), "{report}");
    }
    controller.report("t2012AABB");
    assert_eq!(next(&mut here).what, Incoming::Frame(frame(0x201, &[0xAA, 0xBB])));
    assert_eq!(here.send(&frame(0x001, b"STOP")).unwrap(), Sent::Done);
    let mut written = [0; 14];
    controller.line.read_exact(&mut written).unwrap();
    assert_eq!(&written, b"t001453544F50\r");
    controller.report("sb000255");
    assert_eq!(next(&mut here).what, Incoming::Event(BusEvent::BusOff));
    // The kernel would queue ten frames now and send them when they are out of date.
    assert!(matches!(here.send(&frame(0x001, b"STOP")), Err(LinkError::BusOff { .. })));
    assert!(Interface::query(&name).unwrap().is_off_bus);
    assert!(matches!(SocketCan::open(&name, Dialect::Classic), Err(LinkError::BusOff { .. })));
    // This kind of controller has no other restart.
    ip(&format!("link set {name} down"));
    controller.up();
    assert!(matches!(here.receive(), Err(LinkError::Down { .. })));
    assert_eq!(here.send(&frame(0x001, b"STOP")).unwrap(), Sent::Done);
    controller.line.read_exact(&mut written).unwrap();
    assert_eq!(&written, b"t001453544F50\r");
}

#[test]
fn without_can_in_the_kernel_that_is_what_is_said() {
    let has_can = CanSocket::open_iface(0).is_ok();
    let error = SocketCan::open("nocan7", Dialect::Classic).unwrap_err();
    if has_can {
        assert!(matches!(error, LinkError::NoInterface { .. }), "{error}");
    } else {
        assert!(error.to_string().starts_with("this kernel has no CAN: "), "{error}");
    }
}
