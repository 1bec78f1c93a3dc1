//! Handshake: records of any length, cut into segments.
//!
//! ```text
//! record:  [length of body, u16] [body: postcard] [CRC-32 over length and body, u32]
//! segment: [index 0..=0x3F, 0x80 added on the last] [next bytes of the record]
//! ```
//! All segments but the last are full frames, so an index says where its bytes belong. In CAN FD the last is filled up with
//! zeros to a length that exists.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use super::auth::{Proof, SessionKey, Tag};
use super::checksum::{Context, record_crc32};
use super::fields::Take;
use super::frame::{Dialect, Frame, append, fd_length};
use super::ids;
use super::message::{FromArm, OpenRequest, Refusal, ToArm};
use super::rejected::Rejected;
use crate::plan::{Fnv1a64, StartPose};
use crate::pose::Pose;

/// Most bytes of a record.
const MAX_RECORD: usize = 256;

/// Most bytes of a record's body: less length and checksum.
const MAX_BODY: usize = 250;

/// Marks the last segment.
const LAST: u8 = 0x80;

/// CAN FD lengths are at most 16 bytes apart.
const PADDING_LESS_THAN: usize = 16;

/// What the executor says in the handshake.
#[derive(Serialize, Deserialize)]
pub(super) enum ToArmRecord {
    /// See [`ToArm::Open`].
    Open(OpenRequest),
    /// See [`ToArm::OpenKeyed`].
    OpenKeyed(OpenRequest, Proof),
}

/// What the arm says in the handshake.
#[derive(Serialize, Deserialize)]
pub(super) enum FromArmRecord {
    /// See [`FromArm::Opened`].
    Opened { session: u16, nonce: u32, digest: u64 },
    /// See [`FromArm::Refused`].
    Refused { session: u16, reason: Refusal },
    /// See [`FromArm::Anchored`].
    Anchored { session: u16, pose: StartPose },
    /// See [`FromArm::OpenedKeyed`].
    OpenedKeyed { session: u16, nonce: u32, digest: u64, tag: Tag },
    /// See [`FromArm::Anchored`], in a session with a key.
    AnchoredKeyed { session: u16, pose: StartPose, tag: Tag },
}

impl FromArmRecord {
    pub(super) fn anchored(context: &Context, pose: &Pose) -> Self {
        let (session, pose) = (context.session, StartPose::from(pose));
        match &context.key {
            Some(key) => Self::AnchoredKeyed { session, pose, tag: tag_of_anchor(key, session, pose) },
            None => Self::Anchored { session, pose },
        }
    }

    /// What it says to an end that is in `own`; `None` if it lacks the tag that it needs there.
    pub(super) fn into_message(self, own: &Context) -> Option<FromArm> {
        Some(match self {
            Self::Opened { session, nonce, digest } => FromArm::Opened { session, nonce, digest },
            Self::OpenedKeyed { session, nonce, digest, tag } => {
                FromArm::OpenedKeyed { session, nonce, digest, tag }
            }
            Self::Refused { session, reason } => FromArm::Refused { session, reason },
            Self::Anchored { session, pose } if own.key.is_none() => {
                FromArm::Anchored { session, pose: pose.pose() }
            }
            Self::AnchoredKeyed { session, pose, tag } => {
                own.key.filter(|key| tag_of_anchor(key, session, pose) == tag)?;
                FromArm::Anchored { session, pose: pose.pose() }
            }
            Self::Anchored { .. } => return None,
        })
    }
}

/// Over the body of the record without a tag. (It fits, as the largest body does, which a test checks.)
fn tag_of_anchor(key: &SessionKey, session: u16, pose: StartPose) -> Tag {
    let mut buffer = [0; MAX_BODY];
    let body = postcard::to_slice(&FromArmRecord::Anchored { session, pose }, &mut buffer).ok();
    key.frame(ids::HANDSHAKE_FROM_ARM, 0, body.as_deref().unwrap_or_default())
}

impl ToArmRecord {
    pub(super) fn into_message(self) -> ToArm {
        match self {
            Self::Open(request) => ToArm::Open(request),
            Self::OpenKeyed(request, proof) => ToArm::OpenKeyed(request, proof),
        }
    }
}

/// FNV-1a over the body of the record that asks for a session. (The largest body that exists fits, which a test checks.)
pub(super) fn digest(request: &OpenRequest) -> u64 {
    let mut buffer = [0; MAX_BODY];
    let mut digest = Fnv1a64::default();
    if let Ok(body) = postcard::to_slice(&ToArmRecord::Open(*request), &mut buffer) {
        digest.update(body);
    }
    digest.value()
}

/// What a proof of a request covers: its kind, the nonce, and the body of the record without a proof. (It fits, likewise.)
pub(super) fn covered_by_proof(kind: u8, nonce: u64, request: &OpenRequest) -> Vec<u8, MAX_RECORD> {
    let (mut covered, mut buffer) = (Vec::new(), [0; MAX_BODY]);
    let body = postcard::to_slice(&ToArmRecord::Open(*request), &mut buffer).ok();
    let parts = [&[kind][..], &nonce.to_le_bytes(), body.as_deref().unwrap_or_default()];
    let _ = parts.into_iter().try_for_each(|part| append(&mut covered, part));
    covered
}

/// The frames of one record, cut as they are asked for.
#[derive(Clone, Debug)]
pub(super) struct Segments {
    id: u16,
    dialect: Dialect,
    record: Vec<u8, MAX_RECORD>,
    sent: usize,
    index: u8,
}

impl Segments {
    /// A record around `body`. The largest body that exists fits, which a test checks.
    pub(super) fn new<T: Serialize>(id: u16, dialect: Dialect, body: &T) -> Self {
        let mut buffer = [0; MAX_BODY];
        let body = postcard::to_slice(body, &mut buffer).ok();
        let record = body.and_then(|body| sealed(body)).unwrap_or_default();
        Self { id, dialect, record, sent: 0, index: 0 }
    }
}

fn sealed(body: &[u8]) -> Option<Vec<u8, MAX_RECORD>> {
    let mut record = Vec::new();
    append(&mut record, &u16::try_from(body.len()).ok()?.to_le_bytes())?;
    append(&mut record, body)?;
    let crc = record_crc32(&record);
    append(&mut record, &crc.to_le_bytes())?;
    Some(record)
}

impl Iterator for Segments {
    type Item = Frame;

    fn next(&mut self) -> Option<Frame> {
        let rest = self.record.get(self.sent..)?;
        let taken = rest.len().min(self.dialect.max_data().saturating_sub(1));
        let payload = rest.get(..taken).filter(|payload| !payload.is_empty())?;
        let last = if taken == rest.len() { LAST } else { 0 };
        let mut data = Vec::new();
        data.push(self.index | last).ok()?;
        append(&mut data, payload)?;
        if self.dialect == Dialect::Fd {
            data.resize(fd_length(data.len()), 0).ok()?;
        }
        self.sent = self.sent.saturating_add(taken);
        self.index = self.index.saturating_add(1);
        Some(Frame { id: self.id, data })
    }
}

/// One segment, by itself as it should be.
struct Segment<'a> {
    index: u8,
    last: bool,
    /// Where its bytes belong in the record.
    begin: usize,
    end: usize,
    payload: &'a [u8],
}

impl<'a> Segment<'a> {
    /// `None` for one that no record has.
    fn read(dialect: Dialect, data: &'a [u8]) -> Option<Self> {
        let (head, payload) = data.split_first()?;
        let (last, index) = (head & LAST != 0, head & !LAST);
        let full = dialect.max_data();
        let fits =
            if last { data.len() <= full && fd_length(data.len()) == data.len() } else { data.len() == full };
        let begin = usize::from(index).checked_mul(full.checked_sub(1)?)?;
        let end = begin.checked_add(payload.len())?;
        // This bounds the index too: 36 at most.
        let is_one = !payload.is_empty() && fits && end <= MAX_RECORD;
        is_one.then_some(Self { index, last, begin, end, payload })
    }
}

fn bit(index: u8) -> u64 {
    1u64.checked_shl(u32::from(index)).unwrap_or(0)
}

/// The bits of all indices below.
fn below(index: u8) -> u64 {
    bit(index).saturating_sub(1)
}

/// Puts segments together again, in whatever order they come. Those that were lost are filled in when the record is sent
/// again. One that cannot be of the same record as those kept begins another; then, as once a record is complete, what was
/// kept is forgotten.
#[derive(Clone, Debug)]
pub(super) struct Reassembly {
    record: [u8; MAX_RECORD],
    /// Bit i: the segment of index i is kept.
    kept: u64,
    /// The last segment, if it is kept.
    last: Option<Last>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Last {
    index: u8,
    /// Where it ends: the length of the record, padding included.
    end: usize,
}

impl Default for Reassembly {
    fn default() -> Self {
        Self { record: [0; MAX_RECORD], kept: 0, last: None }
    }
}

impl Reassembly {
    /// Takes one segment; the record's content if none is missing any more.
    pub(super) fn handle<T: for<'a> Deserialize<'a>>(
        &mut self,
        dialect: Dialect,
        frame: &Frame,
    ) -> Result<Option<T>, Rejected> {
        let segment = Segment::read(dialect, &frame.data).ok_or(Rejected::Segment { id: frame.id })?;
        if !self.may_have(&segment) {
            *self = Self::default();
        }
        self.keep(&segment);
        let Some(length) = self.complete() else { return Ok(None) };
        let content = self.record.get(..length).and_then(|record| content(record, dialect));
        *self = Self::default();
        content.map(Some).ok_or(Rejected::Record { id: frame.id })
    }

    /// Whether a record could have this segment and all that are kept.
    fn may_have(&self, segment: &Segment<'_>) -> bool {
        let Segment { index, last, begin, end, payload } = *segment;
        if self.kept & bit(index) != 0 && self.record.get(begin..end) != Some(payload) {
            return false;
        }
        match self.last {
            Some(known) if last => known == Last { index, end },
            Some(known) => index < known.index,
            None => !last || self.kept & !below(index) == 0,
        }
    }

    fn keep(&mut self, segment: &Segment<'_>) {
        let Segment { index, last, begin, end, payload } = *segment;
        if let Some(place) = self.record.get_mut(begin..end) {
            // Of one length; a copy of slices would have to panic if they were not.
            place.iter_mut().zip(payload).for_each(|(kept, sent)| *kept = *sent);
            self.kept |= bit(index);
        }
        if last {
            self.last = Some(Last { index, end });
        }
    }

    /// Length of the record if all of it is there.
    fn complete(&self) -> Option<usize> {
        let last = self.last?;
        (self.kept == below(last.index) | bit(last.index)).then_some(last.end)
    }
}

/// What a whole record says, if it is whole.
fn content<T: for<'a> Deserialize<'a>>(record: &[u8], dialect: Dialect) -> Option<T> {
    let length = Take(record).u16()?;
    let covered = record.get(..usize::from(length).checked_add(2)?)?;
    let (crc, padding) = record.get(covered.len()..)?.split_first_chunk::<4>()?;
    let padding_most = if dialect == Dialect::Fd { PADDING_LESS_THAN } else { 1 };
    if padding.len() >= padding_most || padding.iter().any(|byte| *byte != 0) {
        return None;
    }
    if record_crc32(covered) != u32::from_le_bytes(*crc) {
        return None;
    }
    let (value, rest) = postcard::take_from_bytes(covered.get(2..)?).ok()?;
    rest.is_empty().then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::displacement::Lsb;
    use crate::fault::{Fault, FaultCode};
    use crate::limits::Limits;
    use crate::wire::auth::{KEY_BYTES, Key};

    #[test]
    fn the_largest_records_fit() {
        let limits = Limits {
            workspace_min_m: [0.0; 3],
            workspace_max_m: [1.0; 3],
            linear_velocity_m_s: 1.0,
            linear_acceleration_m_s2: 1.0,
            linear_jerk_m_s3: 1.0,
            angular_velocity_rad_s: 1.0,
            angular_acceleration_rad_s2: 1.0,
            angular_jerk_rad_s3: 1.0,
        };
        let request = OpenRequest {
            version: u16::MAX,
            session: u16::MAX,
            plan_hash: u64::MAX,
            period_us: u32::MAX,
            end_tick: u32::MAX,
            lsb: Lsb { translation_nm: u32::MAX, rotation_nrad: u32::MAX },
            limits,
            start_level: u16::MAX,
            reset_nonce: u32::MAX,
        };
        let open = Segments::new(ids::HANDSHAKE_TO_ARM, Dialect::Classic, &ToArmRecord::Open(request));
        assert_eq!(open.record.len(), 6 + 141);
        assert_eq!(open.count(), 21);
        let fault = Fault { code: FaultCode::OperatorStop, tick: u32::MAX };
        let refused = FromArmRecord::Refused {
            session: u16::MAX,
            reason: Refusal::Latched { fault: fault.into(), nonce: u32::MAX },
        };
        let proven = ToArmRecord::OpenKeyed(request, Proof { nonce: u64::MAX, tag: Tag([0xFF; 8]) });
        let proven = Segments::new(ids::HANDSHAKE_TO_ARM, Dialect::Classic, &proven);
        assert_eq!(proven.record.len(), 6 + 159);
        assert_eq!(covered_by_proof(1, u64::MAX, &request).len(), 9 + 141);
        let open = Context { session: u16::MAX, ..Context::NONE };
        let anchored = FromArmRecord::anchored(&open, &Pose::identity());
        let key = Key::new(&[1; KEY_BYTES]).session(&request, 1, 1);
        let keyed = FromArmRecord::anchored(&open.with_key(key), &Pose::identity());
        for (record, length) in [(refused, 17), (anchored, 60), (keyed, 68)] {
            let segments = Segments::new(ids::HANDSHAKE_FROM_ARM, Dialect::Fd, &record);
            assert_eq!(segments.record.len(), 6 + length);
        }
    }
}
