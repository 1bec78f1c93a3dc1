//! The executor with its wire: frames in, frames out.

use powderline_shared::plan::PlanReader;
use powderline_shared::wire::Context;
use powderline_shared::wire::auth::TagWatch;
use powderline_shared::wire::codec::{Encoder, Frames, FromArmDecoder, Rejected};
use powderline_shared::wire::frame::{Dialect, Frame};

use crate::session::{Action, Config, Executor, Outcome};

/// What to do now.
#[derive(Clone, Debug, PartialEq)]
pub enum FrameAction {
    /// Send this; then poll again.
    Send(Frame),
    /// Nothing before [`Endpoint::poll_at`], unless a frame arrives.
    Wait,
    /// The session is over.
    Finished(Outcome),
}

/// An [`Executor`] that speaks in frames. A frame that cannot be sent may be dropped: whatever matters is said again.
#[derive(Clone, Debug)]
pub struct Endpoint<'a> {
    executor: Executor<'a>,
    context: Context,
    encoder: Encoder,
    decoder: FromArmDecoder,
    tags: TagWatch,
    leaving: Option<Frames>,
    sent: u32,
    received: u32,
    rejected: u32,
    wrong_tags: u32,
}

impl<'a> Endpoint<'a> {
    /// Opens a session with the next poll. What one count is worth is settled by the wire.
    #[must_use]
    pub fn new(now_us: u64, plan: &PlanReader<'a>, dialect: Dialect, config: Config) -> Self {
        let executor = Executor::new(now_us, plan, Config { lsb: Some(dialect.lsb()), ..config });
        let context = executor.context();
        let mut decoder = FromArmDecoder::new(dialect);
        decoder.set_context(context);
        Self {
            executor,
            context,
            encoder: Encoder::new(dialect),
            decoder,
            tags: TagWatch::default(),
            leaving: None,
            sent: 0,
            received: 0,
            rejected: 0,
            wrong_tags: 0,
        }
    }

    /// Takes in one frame.
    ///
    /// # Errors
    /// Why it was dropped.
    pub fn handle_frame(&mut self, now_us: u64, frame: &Frame) -> Result<(), Rejected> {
        self.received = self.received.saturating_add(1);
        match self.decoder.handle_frame(frame) {
            Ok(messages) => {
                messages.iter().for_each(|message| self.executor.handle_message(now_us, message));
                self.follow_session();
                Ok(())
            }
            Err(rejected) => {
                self.rejected = self.rejected.saturating_add(1);
                if self.context.key.is_some() && matches!(rejected, Rejected::Checksum { .. }) {
                    self.wrong_tags = self.wrong_tags.saturating_add(1);
                }
                if self.tags.is_too_many(self.encoder.dialect(), &self.context, &rejected) {
                    self.executor.handle_wrong_tags(now_us);
                }
                Err(rejected)
            }
        }
    }

    /// The executor takes another session number if the arm wants it so.
    fn follow_session(&mut self) {
        if self.context != self.executor.context() {
            self.context = self.executor.context();
            self.decoder.set_context(self.context);
        }
    }

    /// What to do now. Call until it says [`FrameAction::Wait`] or [`FrameAction::Finished`].
    pub fn poll(&mut self, now_us: u64) -> FrameAction {
        loop {
            if let Some(frame) = self.leaving.as_mut().and_then(Iterator::next) {
                self.sent = self.sent.saturating_add(1);
                return FrameAction::Send(frame);
            }
            match self.executor.poll(now_us) {
                Action::Send(message) => {
                    self.leaving = Some(self.encoder.to_arm(&self.context, &message));
                    self.executor.last_sent().into_iter().for_each(|setpoint| self.decoder.expect(setpoint));
                }
                Action::Wait => return FrameAction::Wait,
                Action::Finished(outcome) => return FrameAction::Finished(outcome),
            }
        }
    }

    /// The same while the wire has no room; see [`Executor::poll_urgent`].
    pub fn poll_urgent(&mut self, now_us: u64) -> FrameAction {
        match self.executor.poll_urgent(now_us) {
            Action::Send(message) => match self.encoder.to_arm(&self.context, &message).next() {
                Some(frame) => {
                    self.sent = self.sent.saturating_add(1);
                    FrameAction::Send(frame)
                }
                None => FrameAction::Wait,
            },
            Action::Wait => FrameAction::Wait,
            Action::Finished(outcome) => FrameAction::Finished(outcome),
        }
    }

    /// When to poll next even if no frame arrives, microseconds; a moment in the past means at once, `None` that the
    /// session is over.
    #[must_use]
    pub fn poll_at(&self) -> Option<u64> {
        self.executor.poll_at()
    }

    /// The state machine behind.
    #[must_use]
    pub fn executor(&self) -> &Executor<'a> {
        &self.executor
    }

    /// The same, to ask it for a stop.
    pub fn executor_mut(&mut self) -> &mut Executor<'a> {
        &mut self.executor
    }

    /// Frames sent, received, and dropped of those received.
    #[must_use]
    pub fn frame_counts(&self) -> [u32; 3] {
        [self.sent, self.received, self.rejected]
    }

    /// Frames and records dropped, in a session with a key, for a tag that was not made with it; a damaged one looks like that.
    #[must_use]
    pub fn wrong_tags(&self) -> u32 {
        self.wrong_tags
    }
}
