//! What the controller knows about the executor's session, and which sessions it admits.

use powderline_shared::displacement::{Lsb, pose_at};
use powderline_shared::limits::{Limit, LimitChecker, Limits, Violation};
use powderline_shared::plan::PERIOD_US_MIN;
use powderline_shared::pose::{Pose, norm};
use powderline_shared::wire::Context;
use powderline_shared::wire::auth::Proof;
use powderline_shared::wire::message::{DEPTH, NO_SESSION, OpenRequest, PROTOCOL_VERSION, Refusal};

use crate::buffer::SetpointBuffer;

/// Longest control period of a session, microseconds. What stops the arm takes effect at a tick, so this adds to the time
/// that a stop takes.
pub const LONGEST_PERIOD_US: u32 = 100_000;

/// Setpoints are rounded to an LSB that the executor chooses, and the limit check grants them what that rounding can add.
/// This is the largest share of the arm's own limits that it may come to.
const MAX_NOISE_SHARE: f64 = 0.2;

/// An open session.
#[derive(Clone, Debug)]
pub(crate) struct Session {
    pub(crate) request: OpenRequest,
    /// What its frames are sealed with.
    pub(crate) context: Context,
    /// Of this opening alone.
    pub(crate) nonce: u32,
    /// What the executor has shown that it has the key with.
    pub(crate) proof: Option<Proof>,
    /// The tighter of the arm's own and the session's.
    pub(crate) limits: Limits,
    pub(crate) anchored: Option<Anchored>,
}

impl Session {
    pub(crate) fn new(
        (request, proof): (&OpenRequest, Option<Proof>),
        own_limits: &Limits,
        (context, nonce): (Context, u32),
    ) -> Self {
        Self {
            request: *request,
            context,
            nonce,
            proof,
            limits: own_limits.tighter(&request.limits),
            anchored: None,
        }
    }

    /// Whether a limit may be broken only because a setpoint was lost shortly before.
    pub(crate) fn is_echo(&self, violation: &Violation) -> bool {
        let Some(anchored) = &self.anchored else { return false };
        violation.tick <= anchored.echo_until && !self.is_bad_by_itself(anchored, violation)
    }

    /// Whether the refused pose is a setpoint that lies outside the workspace, or too far from the last one that has
    /// arrived, whatever came between.
    fn is_bad_by_itself(&self, anchored: &Anchored, violation: &Violation) -> bool {
        let OpenRequest { lsb, period_us, .. } = self.request;
        let Some(setpoint) = anchored.buffer.peek(violation.tick) else { return false };
        if matches!(violation.limit, Limit::Workspace(_)) {
            return true;
        }
        let (tick, pose) = anchored.received;
        let step = pose.displacement_to(&pose_at(&anchored.anchor, setpoint, lsb));
        let time_s = f64::from(setpoint.tick.saturating_sub(tick)) * f64::from(period_us) / 1e6;
        // Rounding moves both ends by up to sqrt(3) / 2 LSB.
        let farthest = |speed: f64, lsb: f64| speed * time_s + 2.0 * lsb;
        norm(&step.translation()) > farthest(self.limits.linear_velocity_m_s, lsb.translation_m())
            || norm(&step.rotation()) > farthest(self.limits.angular_velocity_rad_s, lsb.rotation_rad())
    }
}

/// What exists from enabling on.
#[derive(Clone, Debug)]
pub(crate) struct Anchored {
    pub(crate) anchor: Pose,
    pub(crate) checker: LimitChecker,
    pub(crate) buffer: SetpointBuffer,
    pub(crate) applied_tick: u32,
    pub(crate) lost: u32,
    /// The last setpoint taken that had really arrived: its tick, and where it led.
    pub(crate) received: (u32, Pose),
    /// A limit broken up to this tick is the echo of a lost setpoint.
    pub(crate) echo_until: u32,
    /// The last setpoint has been reached; nothing more may come.
    pub(crate) ended: bool,
}

impl Anchored {
    pub(crate) fn new(session: &Session, anchor: Pose) -> Self {
        let OpenRequest { lsb, period_us, .. } = session.request;
        Self {
            anchor,
            checker: LimitChecker::new(session.limits, lsb, period_us, anchor),
            buffer: SetpointBuffer::default(),
            applied_tick: 0,
            lost: 0,
            received: (0, anchor),
            echo_until: 0,
            ended: false,
        }
    }

    /// The tick up to which setpoints would last if none of those between were lost.
    pub(crate) fn ahead_until(&self) -> u32 {
        self.applied_tick.saturating_add(u32::from(self.buffer.count_after(self.applied_tick)))
    }
}

/// Whether an arm that is idle opens the session.
pub(crate) fn admit(request: &OpenRequest, own_limits: &Limits, counts: Option<Lsb>) -> Result<(), Refusal> {
    if request.version != PROTOCOL_VERSION {
        return Err(Refusal::Version { arm: PROTOCOL_VERSION });
    }
    if !(PERIOD_US_MIN..=LONGEST_PERIOD_US).contains(&request.period_us) {
        return Err(Refusal::Period);
    }
    if counts.is_some_and(|counts| counts != request.lsb) {
        return Err(Refusal::Counts);
    }
    let limits = own_limits.tighter(&request.limits);
    let meaningful = request.session != NO_SESSION
        && request.lsb.is_valid()
        && request.end_tick > 0
        && (1..=DEPTH).contains(&u32::from(request.start_level))
        && request.limits.validate().is_ok()
        && limits.validate().is_ok()
        && limits.check_resolution(request.lsb, request.period_us).is_ok();
    if !meaningful {
        return Err(Refusal::Meaningless);
    }
    if own_limits.noise_share(request.lsb, request.period_us) > MAX_NOISE_SHARE {
        return Err(Refusal::Coarse);
    }
    Ok(())
}
