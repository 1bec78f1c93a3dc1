//! The one driver loop: [`turn`] moves frames between an [`Endpoint`] and a [`Device`]. Devices are what the program `execute`
//! has of Linux, and, by a feature each, drivers that others wrote, whatever implements the traits of embedded Rust.
//!
//! | feature        | module   | device                                                     | dialect |
//! |----------------|----------|------------------------------------------------------------|---------|
//! | `embedded-can` | `can`    | `embedded_can::nb::Can`                                    | classic |
//! | `embedded-io`  | `serial` | `embedded_io::{Read, ReadReady, Write, WriteReady}`         | FD      |
//!
//! One call of [`turn`] in each round of the control loop fetches what has arrived and hands on what is to be said. It never
//! waits, and does at most [`MOST_PIECES`] pieces of work in either direction: neither a device without room nor a line
//! that babbles holds up the loop, and the session's own times go on meanwhile.
//!
//! At most one frame waits in an adapter, for a device that has no room or has given it back. What comes after it is decided
//! when there is room, so no setpoint grows old in a queue. A hard stop does not wait behind that frame.

#[cfg(feature = "embedded-can")]
pub mod can;
#[cfg(feature = "embedded-io")]
pub mod serial;

use powderline_shared::wire::frame::Frame;

use crate::endpoint::{Endpoint, FrameAction};
use crate::session::Outcome;

/// Most pieces (frames, or reads of a line) in one direction and turn. An arm says five frames in a tick; an executor that
/// begins to stream says up to 32.
pub const MOST_PIECES: usize = 32;

/// What a turn has come to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// There is nothing to do before [`Endpoint::poll_at`], unless something arrives.
    Idle,
    /// A frame waits for room in the device, or there was more to do than for one turn: the next one should come soon.
    Unfinished,
    /// The session is over.
    Finished(Outcome),
}

/// The device is no wire any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gone;

/// What an adapter makes of its device.
pub trait Device {
    /// Fetches a piece of what has arrived, and hands on its frames. Whether there may be more.
    ///
    /// # Errors
    /// The device is no wire any more.
    fn fetch(&mut self, heard: impl FnMut(&Frame)) -> Result<bool, Gone>;

    /// Hands on what waits. Whether there is room for another frame.
    ///
    /// # Errors
    /// The device is no wire any more.
    fn make_room(&mut self) -> Result<bool, Gone>;

    /// Takes a frame to be sent; one that waits need not be sent any more.
    ///
    /// # Errors
    /// The device never carries it.
    fn put(&mut self, frame: &Frame) -> Result<(), Gone>;

    /// Called after each frame that the endpoint has given out, for whoever measures.
    fn look(&mut self, _endpoint: &Endpoint<'_>) {}
}

/// One round of the loop: what has arrived goes to the endpoint, what it has to say goes to the device, as far as there is room.
///
/// `now_us` is the clock, microseconds, which never goes back. It is asked for each frame: an executor that is kept from its work must
/// not think that an arm is ahead of its time.
pub fn turn(device: &mut impl Device, now_us: impl Fn() -> u64, endpoint: &mut Endpoint<'_>) -> Turn {
    let more = receive(device, &now_us, endpoint);
    match send(device, now_us(), endpoint) {
        Turn::Idle if more => Turn::Unfinished,
        turn => turn,
    }
}

/// Whether there may be more.
fn receive(device: &mut impl Device, now_us: &impl Fn() -> u64, endpoint: &mut Endpoint<'_>) -> bool {
    for _ in 0..MOST_PIECES {
        let fetched = device.fetch(|frame| {
            // What cannot be understood is dropped, and counted there.
            let _ = endpoint.handle_frame(now_us(), frame);
        });
        match fetched {
            Ok(true) => {}
            Ok(false) => return false,
            Err(Gone) => {
                endpoint.executor_mut().handle_link_lost(now_us());
                return false;
            }
        }
    }
    true
}

/// Lets the endpoint speak for as long as there is room. In the turns after a failure too: the stop that it then asks for
/// may get through.
fn send(device: &mut impl Device, now_us: u64, endpoint: &mut Endpoint<'_>) -> Turn {
    for _ in 0..MOST_PIECES {
        let (room, action) = match device.make_room() {
            Ok(true) => (true, endpoint.poll(now_us)),
            Ok(false) => (false, endpoint.poll_urgent(now_us)),
            Err(Gone) => {
                endpoint.executor_mut().handle_link_lost(now_us);
                (false, endpoint.poll_urgent(now_us))
            }
        };
        match action {
            FrameAction::Send(frame) => {
                device.look(endpoint);
                if device.put(&frame).is_err() {
                    endpoint.executor_mut().handle_link_lost(now_us);
                }
            }
            FrameAction::Wait if room => return Turn::Idle,
            FrameAction::Wait => return Turn::Unfinished,
            FrameAction::Finished(outcome) => return Turn::Finished(outcome),
        }
    }
    Turn::Unfinished
}
