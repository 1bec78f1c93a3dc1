//! The executor's core as a microcontroller's program would use it. See `Cargo.toml` for what this proves.
#![no_std]

#[cfg(feature = "adapters")]
pub mod adapters;

use core::panic::PanicInfo;

use powderline_executor::{Action, Config, Executor};
use powderline_shared::plan::PlanReader;
use powderline_shared::wire::message::{FromArm, ToArm};

/// One turn of the loop that talks to an arm: a message in, a message out.
pub fn turn(executor: &mut Executor<'_>, now_us: u64, heard: Option<&FromArm>) -> Option<ToArm> {
    if let Some(message) = heard {
        executor.handle_message(now_us, message);
    }
    match executor.poll(now_us) {
        Action::Send(message) => Some(message),
        Action::Wait | Action::Finished(_) => None,
    }
}

/// A session for a plan in flash, if it is one that keeps its own limits.
pub fn session(plan: &[u8], now_us: u64) -> Option<Executor<'_>> {
    let plan = PlanReader::new(plan).ok()?;
    plan.check_limits().ok()?;
    Some(Executor::new(now_us, &plan, Config::default()))
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}
