//! `SysTick` as a clock of 64 bits.

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use cortex_m_rt::exception;

/// Counts per microsecond: the board runs at 25 MHz.
const COUNTS_PER_US: u64 = 25;

/// Counts in a round: all that the counter of 24 bits can hold, so that an emulator which is held up for a while loses none.
const ROUND: u32 = 1 << 24;

static ROUNDS: AtomicU32 = AtomicU32::new(0);

#[exception]
fn SysTick() {
    ROUNDS.store(ROUNDS.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
}

/// The running clock.
pub struct Clock(());

impl Clock {
    /// Starts counting from zero.
    pub fn start(mut syst: SYST) -> Self {
        syst.set_clock_source(SystClkSource::Core);
        syst.set_reload(ROUND - 1);
        syst.clear_current();
        syst.enable_interrupt();
        syst.enable_counter();
        Self(())
    }

    /// Counts since the start.
    pub fn counts(&self) -> u64 {
        loop {
            let rounds = ROUNDS.load(Ordering::Relaxed);
            let left = SYST::get_current();
            // The counter may have begun another round whose interrupt has not been taken yet.
            if !SCB::is_pendst_pending() && rounds == ROUNDS.load(Ordering::Relaxed) {
                let into_round = if left == 0 { 0 } else { ROUND.wrapping_sub(left) };
                return u64::from(rounds).wrapping_mul(u64::from(ROUND)).wrapping_add(u64::from(into_round));
            }
        }
    }

    /// Microseconds since the start.
    pub fn now_us(&self) -> u64 {
        self.counts() / COUNTS_PER_US
    }
}

/// Instructions that QEMU ran in so many counts, under `-icount shift=10`: one takes 1,024 ns, one count 40 ns.
pub fn instructions(counts: u64) -> u64 {
    counts.wrapping_mul(40) / 1024
}
