//! The controller with its wire: frames in, frames out.

use powderline_shared::wire::Context;
use powderline_shared::wire::auth::TagWatch;
use powderline_shared::wire::codec::{Encoder, Frames, ToArmDecoder};
use powderline_shared::wire::frame::{Dialect, Frame};
use powderline_shared::wire::message::{FromArm, NO_SESSION};

use crate::controller::Controller;

/// A [`Controller`] that speaks in frames.
#[derive(Clone, Debug)]
pub struct Endpoint {
    controller: Controller,
    encoder: Encoder,
    decoder: ToArmDecoder,
    tags: TagWatch,
    /// The open session, or none; and the one that was open last before it, which is asked about and answered even while the
    /// next one is open.
    contexts: [Context; 2],
    leaving: Option<Frames>,
}

impl Endpoint {
    /// Joins a controller to a wire.
    #[must_use]
    pub fn new(mut controller: Controller, dialect: Dialect) -> Self {
        controller.set_counts(dialect.lsb());
        Self {
            controller,
            encoder: Encoder::new(dialect),
            decoder: ToArmDecoder::new(dialect),
            tags: TagWatch::default(),
            contexts: [Context::NONE; 2],
            leaving: None,
        }
    }

    /// Takes in one frame; one that cannot be understood is counted and dropped.
    pub fn handle_frame(&mut self, now_us: u64, frame: &Frame) {
        // Time first: it may close the session that the frame would be read by.
        self.controller.let_pass(now_us);
        self.follow_session();
        match self.decoder.handle_frame(frame) {
            Ok(messages) => {
                for message in &messages {
                    self.controller.handle_message(now_us, message);
                    self.follow_session();
                }
            }
            Err(rejected) => {
                self.controller.handle_rejected();
                let [context, _] = &self.contexts;
                if self.tags.is_too_many(self.encoder.dialect(), context, &rejected) {
                    self.controller.handle_wrong_tags();
                }
            }
        }
    }

    /// Lets time pass; then the next frame, if any. Call until `None`.
    pub fn poll(&mut self, now_us: u64) -> Option<Frame> {
        loop {
            if let Some(frame) = self.leaving.as_mut().and_then(Iterator::next) {
                return Some(frame);
            }
            let message = self.controller.poll(now_us);
            self.follow_session();
            let message = message?;
            self.leaving = Some(self.encoder.from_arm(&self.context_of(&message), &message));
        }
    }

    /// When to poll next, at the latest.
    #[must_use]
    pub fn poll_at(&self) -> u64 {
        self.controller.poll_at()
    }

    /// The controller behind.
    #[must_use]
    pub fn controller(&self) -> &Controller {
        &self.controller
    }

    /// The same, to read off what it has done.
    pub fn controller_mut(&mut self) -> &mut Controller {
        &mut self.controller
    }

    fn follow_session(&mut self) {
        let now = self.controller.context();
        let [current, closed] = self.contexts;
        if now != current {
            // None between two sessions is not one that was closed.
            self.contexts = [now, if current == Context::NONE { closed } else { current }];
            self.decoder.set_context(now);
        }
    }

    fn context_of(&self, message: &FromArm) -> Context {
        let session = match message {
            FromArm::Opened { session, .. }
            | FromArm::OpenedKeyed { session, .. }
            | FromArm::Refused { session, .. }
            | FromArm::Anchored { session, .. }
            | FromArm::Actual { session, .. }
            | FromArm::Fault { session, .. } => *session,
            FromArm::Status(status) => status.session,
            FromArm::Heartbeat(heartbeat) => heartbeat.session,
        };
        let known =
            self.contexts.into_iter().find(|context| context.session == session && session != NO_SESSION);
        known.unwrap_or(Context::NONE)
    }
}
