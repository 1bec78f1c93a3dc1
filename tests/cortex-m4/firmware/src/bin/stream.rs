//! The firmware: plays the plan in flash to the arm at the other end of the serial line.
#![no_std]
#![no_main]

use cortex_m::peripheral::Peripherals;
use cortex_m_rt::entry;
use powderline_cortex_m4::clock::Clock;
use powderline_cortex_m4::report::{Report, fail};
use powderline_cortex_m4::uart::Uart;
use powderline_cortex_m4::{PLAN, SESSION, planted_panic, stack};
use powderline_executor::{Config, Endpoint, FrameAction, Outcome};
use powderline_shared::plan::PlanReader;
use powderline_shared::wire::frame::Dialect;
use powderline_shared::wire::serial::{LineReader, to_line};

#[entry]
fn main() -> ! {
    let Some(peripherals) = Peripherals::take() else { fail("the peripherals are taken") };
    // SAFETY: the only one.
    let mut uart = unsafe { Uart::new() };
    let clock = Clock::start(peripherals.SYST);
    planted_panic();

    let Ok(plan) = PlanReader::new(PLAN) else { fail("the plan in flash is none") };
    if plan.check_limits().is_err() {
        fail("the plan breaks its own limits");
    }
    let config = Config { session: SESSION, ..Config::default() };
    let began_us = clock.now_us();
    let mut endpoint = Endpoint::new(began_us, &plan, Dialect::Fd, config);
    let mut reader = LineReader::new();
    let mut garbled = 0_u64;
    loop {
        while let Some(byte) = uart.receive() {
            match reader.push(byte) {
                // What it rejects it counts.
                Some(Ok(frame)) => drop(endpoint.handle_frame(clock.now_us(), &frame)),
                Some(Err(_)) => garbled = garbled.wrapping_add(1),
                None => {}
            }
        }
        match endpoint.poll(clock.now_us()) {
            FrameAction::Send(frame) => uart.send(&to_line(&frame)),
            // The arm's next byte may be there already: nothing here sleeps.
            FrameAction::Wait => {}
            FrameAction::Finished(outcome) => {
                let us = clock.now_us().wrapping_sub(began_us);
                report(&endpoint, garbled, outcome, us)
            }
        }
    }
}

fn report(endpoint: &Endpoint<'_>, garbled: u64, outcome: Outcome, us: u64) -> ! {
    let [sent, received, rejected] = endpoint.frame_counts();
    let mut report = Report::new("stream:");
    report
        .number(
            "fault",
            match outcome {
                Outcome::Completed => 0,
                Outcome::Stopped { fault, .. } => u64::from(fault.code.number()),
            },
        )
        .number("setpoints", u64::from(endpoint.executor().telemetry().sent))
        .number("resent", u64::from(endpoint.executor().telemetry().resent))
        .number("frames_sent", u64::from(sent))
        .number("frames_received", u64::from(received))
        .number("frames_rejected", u64::from(rejected))
        .number("garbled", garbled)
        .number("session_us", us)
        .number("stack_bytes", u64::from(stack::most_used_bytes()));
    report.succeed()
}
