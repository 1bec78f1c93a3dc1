//! Frames made small enough for a page.
//!
//! | part       | how it is stored                                                                              |
//! |------------|-----------------------------------------------------------------------------------------------|
//! | positions  | 16 bits an axis over the simulated volume, as steps from the frame before, zigzag (small       |
//! |            | steps of either sign are small numbers), all low bytes of an axis, then all its high bytes     |
//! | speeds     | 8 bits, root of the share of the fastest, as steps from the frame before                       |
//! | all frames | one after another, deflated with zlib's header, base64                                         |
//!
//! Most powder rests most of the time, so most bytes are zero and deflate to almost nothing.

use std::io::Write as _;

use base64::Engine as _;
use flate2::{Compression, write::ZlibEncoder};
use powderline_shared::pose::Pose;
use serde::Serialize;

use crate::arm::{Arm, Capsule};
use crate::extent::Extent;
use crate::{Bench, Destination, Frame, Role, Sink, ViewError, mesh::Mesh};

/// Steps over the simulated volume, each axis.
const STEPS: f64 = u16::MAX as f64;

/// Frames closer together than this are left out at once: the page interpolates.
const LEAST_PERIOD_S: f64 = 0.02;

/// Speeds wait as multiples of this for the fastest to be known; from 6.5 m/s on they are all one.
const SPEED_QUANTUM_M_S: f64 = 1e-4;

/// QuantisedControls frames never take more memory than this.
const MEMORY_BYTES: usize = 256 << 20;

/// What a page's powder may take, in bytes of the page, if nothing else is asked for: then the whole page stays
/// below 15 MB.
pub const BUDGET_BYTES: usize = 14_000_000;

/// Takes frames for a page, quantised as they come.
///
/// Keeps 50 frames a second or fewer, and always the first and the last; [`Recorder::into_replay`] leaves more out
/// until the rest fits.
#[derive(Clone, Debug)]
pub struct Recorder {
    bench: Bench,
    budget_bytes: usize,
    /// Of the frames that come, each that many-th is kept.
    stride: usize,
    seen: usize,
    kept: Vec<Kept>,
    /// The newest frame, if it is not among those kept.
    newest: Option<Kept>,
    destinations: Vec<Destination>,
}

/// A frame, quantised.
#[derive(Clone, Debug)]
struct Kept {
    time_s: f64,
    tool: Pose,
    planned: Option<Pose>,
    /// Of each particle, in steps over the simulated volume.
    positions: Vec<[u16; 3]>,
    /// Of each particle, in multiples of [`SPEED_QUANTUM_M_S`].
    speeds: Vec<u16>,
}

impl Recorder {
    /// For a page of less than 15 MB.
    #[must_use]
    pub fn new(bench: &Bench) -> Self {
        Self::with_budget(bench, BUDGET_BYTES)
    }

    /// For a page in which the powder takes at most `budget_bytes`; no less than two frames, whatever they take.
    #[must_use]
    pub fn with_budget(bench: &Bench, budget_bytes: usize) -> Self {
        let stride = (LEAST_PERIOD_S / bench.period_s - 1e-6).ceil().max(1.0) as usize;
        let (kept, destinations) = (Vec::new(), Vec::new());
        Self { bench: bench.clone(), budget_bytes, stride, seen: 0, kept, newest: None, destinations }
    }

    /// Bytes that it takes at most for such a bench: the frames, and what is packed of them.
    #[must_use]
    pub fn most_bytes(bench: &Bench) -> u64 {
        const PACKED: u64 = 2;
        let frame_bytes = (bench.particles * size_of::<[u16; 4]>()) as u64;
        // Before there are too many bytes, one frame more.
        let frames = frame_bytes.saturating_mul(bench.frames as u64).min(MEMORY_BYTES as u64 + frame_bytes);
        frames.max(2 * frame_bytes) * (1 + PACKED)
    }

    /// What a page shows of the frames so far; nothing if none came.
    ///
    /// Leaves out the speeds first (the page then takes them from the positions), and then every other frame, again
    /// and again, until the powder fits the budget.
    #[must_use]
    pub fn into_replay(mut self) -> Option<Replay> {
        self.kept.extend(self.newest.take());
        let fastest = self.kept.iter().flat_map(|frame| &frame.speeds).copied().max()?;
        loop {
            for speeds_of in [Some(fastest), None] {
                let powder = packed(&self.kept, speeds_of);
                if powder.len() <= self.budget_bytes || (self.kept.len() <= 2 && speeds_of.is_none()) {
                    let about = About::new(&self, speeds_of);
                    return Some(Replay { about, powder, frames: self.kept.len() });
                }
            }
            thin(&mut self.kept);
        }
    }

    /// The frame in as few bits as are kept of it.
    ///
    /// A frame has as many particles as the bench says: others are not shown, missing ones lie in the corner.
    fn quantise(&self, frame: &Frame<'_>) -> Kept {
        let position = |at: usize| frame.positions_m.get(at).copied().unwrap_or_default();
        let speed = |at: usize| frame.velocities_m_s.get(at).copied().unwrap_or_default();
        let particles = 0..self.bench.particles;
        Kept {
            time_s: frame.time_s,
            tool: frame.tool,
            planned: frame.planned,
            positions: particles.clone().map(|at| steps(position(at), self.bench.size_m)).collect(),
            speeds: particles.map(|at| speed_quanta(speed(at))).collect(),
        }
    }
}

impl Sink for Recorder {
    fn frame(&mut self, frame: &Frame<'_>) -> Result<(), ViewError> {
        let quantised = self.quantise(frame);
        self.newest = None;
        if self.seen.is_multiple_of(self.stride) {
            self.kept.push(quantised);
        } else {
            self.newest = Some(quantised);
        }
        self.seen += 1;
        let frame_bytes = self.bench.particles * size_of::<[u16; 4]>();
        if self.kept.len() > 2 && self.kept.len() * frame_bytes > MEMORY_BYTES {
            thin(&mut self.kept);
            self.stride = self.stride.saturating_mul(2);
        }
        Ok(())
    }

    fn finish(&mut self, destinations: &[Destination]) -> Result<(), ViewError> {
        self.destinations = destinations.to_vec();
        Ok(())
    }
}

/// Every other frame; always the first and the last.
fn thin(kept: &mut Vec<Kept>) {
    let last = kept.len().saturating_sub(1);
    let mut at = 0;
    kept.retain(|_| {
        at += 1;
        (at - 1) % 2 == 0 || at - 1 == last
    });
}

/// A position in steps over the volume; outside of it, its border.
fn steps(position_m: [f32; 3], size_m: [f64; 3]) -> [u16; 3] {
    [0, 1, 2].map(|axis| (f64::from(position_m[axis]) / size_m[axis] * STEPS).round() as u16)
}

fn speed_quanta(velocity_m_s: [f32; 3]) -> u16 {
    let [x, y, z] = velocity_m_s.map(f64::from);
    ((x * x + y * y + z * z).sqrt() / SPEED_QUANTUM_M_S).round() as u16
}

/// A speed in 8 bits. Of the root: slow powder is the most of it, and would else all be one.
fn speed_code(speed: u16, fastest: u16) -> u8 {
    (f64::from(speed) / f64::from(fastest.max(1))).sqrt().mul_add(255.0, 0.5) as u8
}

/// Small differences of either sign as small numbers: 0, -1, 1, -2, 2 as 0, 1, 2, 3, 4.
fn zigzag(from: u16, to: u16) -> u16 {
    let difference = to.wrapping_sub(from) as i16;
    ((difference << 1) ^ (difference >> 15)) as u16
}

/// All frames in base64; with speeds as shares of the fastest, if it is given.
fn packed(kept: &[Kept], fastest: Option<u16>) -> String {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
    let mut before: Option<&Kept> = None;
    for frame in kept {
        // Into memory: this cannot fail.
        let _ = encoder.write_all(&position_steps(before, frame));
        if let Some(fastest) = fastest {
            let _ = encoder.write_all(&speed_steps(before, frame, fastest));
        }
        before = Some(frame);
    }
    base64::engine::general_purpose::STANDARD.encode(encoder.finish().unwrap_or_default())
}

/// Six bytes a particle: of each axis the low bytes, then the high ones.
fn position_steps(before: Option<&Kept>, frame: &Kept) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(6 * frame.positions.len());
    for axis in 0..3 {
        let step = |(at, position): (usize, &[u16; 3])| {
            zigzag(before.map_or(0, |before| before.positions[at][axis]), position[axis])
        };
        let steps: Vec<[u8; 2]> =
            frame.positions.iter().enumerate().map(|each| step(each).to_le_bytes()).collect();
        bytes.extend(steps.iter().map(|step| step[0]));
        bytes.extend(steps.iter().map(|step| step[1]));
    }
    bytes
}

/// One byte a particle.
fn speed_steps(before: Option<&Kept>, frame: &Kept, fastest: u16) -> Vec<u8> {
    let code = |frame: &Kept, at: usize| speed_code(frame.speeds[at], fastest);
    let step = |at| code(frame, at).wrapping_sub(before.map_or(0, |before| code(before, at)));
    (0..frame.speeds.len()).map(step).collect()
}

/// Frames as a page holds them, for [`Page::replay`](super::Page::replay).
#[derive(Clone, Debug)]
pub struct Replay {
    pub(super) about: About,
    /// Base64.
    pub(super) powder: String,
    frames: usize,
}

impl Replay {
    /// How many frames are left.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// What the powder takes of the page.
    #[must_use]
    pub fn powder_bytes(&self) -> usize {
        self.powder.len()
    }
}

/// Everything but the powder, in JSON. The page's script reads these names.
#[derive(Clone, Debug, Serialize)]
pub(super) struct About {
    name: String,
    size_m: [f64; 3],
    /// Lowest and highest corner of what the first picture shows.
    extent_m: [[f64; 3]; 2],
    cell_m: f64,
    target_m: [f64; 3],
    particles: usize,
    containers: Vec<ContainerAbout>,
    gates: Vec<GateAbout>,
    tool: MeshAbout,
    arm: Option<ArmAbout>,
    /// From where the first picture is taken, as a camera's azimuth counts.
    front_deg: f64,
    times_s: Vec<f64>,
    /// Position (m) and quaternion (x, y, z, w).
    poses: Vec<[f64; 7]>,
    planned: Vec<Option<[f64; 7]>>,
    /// Of the fastest particle ever, m/s; null if speeds are not stored.
    fastest_m_s: Option<f64>,
    /// A digit for each particle, see [`digit`]; null if there are not as many as particles.
    destinations: Option<String>,
}

#[derive(Clone, Debug, Serialize)]
struct ContainerAbout {
    name: String,
    role: &'static str,
    mesh: MeshAbout,
}

#[derive(Clone, Debug, Serialize)]
struct GateAbout {
    name: String,
    /// Where it is shut.
    mesh: MeshAbout,
    /// In each frame how far it is from there, metres; null where it is no longer there.
    moved_m: Vec<Option<[f64; 3]>>,
}

#[derive(Clone, Debug, Serialize)]
struct ArmAbout {
    name: &'static str,
    /// Of its column and post, which stand still, then of links and bracket, metres.
    radii_m: Vec<f64>,
    /// Of column and post: the ends of the axis, six numbers each, metres.
    standing_m: Vec<f64>,
    /// Of links and bracket in each frame, likewise.
    moving_m: Vec<Vec<f64>>,
    /// Lowest and highest corner of the block beneath the bench; null if it stands on the table itself.
    stand_m: Option<[[f64; 3]; 2]>,
}

#[derive(Clone, Debug, Serialize)]
struct MeshAbout {
    points_m: Vec<f64>,
    corners: Vec<u32>,
}

impl About {
    fn new(recorder: &Recorder, fastest: Option<u16>) -> Self {
        let Recorder { bench, kept, destinations, .. } = recorder;
        let containers = bench.containers.iter().map(|container| ContainerAbout {
            name: container.name.clone(),
            role: role_name(container.role),
            mesh: MeshAbout::new(&container.mesh),
        });
        let gates = bench.gates.iter().map(|gate| GateAbout {
            name: gate.law.name.clone(),
            mesh: MeshAbout::new(&gate.mesh),
            moved_m: kept
                .iter()
                .map(|frame| gate.law.displacement_m(frame.time_s).map(|moved_m| moved_m.map(rounded)))
                .collect(),
        });
        let known = destinations.len() == bench.particles;
        Self {
            name: bench.name.clone(),
            size_m: bench.size_m,
            extent_m: [bench.extent.low_m, bench.extent.high_m].map(|corner| corner.map(rounded)),
            cell_m: bench.cell_m,
            target_m: bench.target_m,
            particles: bench.particles,
            containers: containers.collect(),
            gates: gates.collect(),
            tool: MeshAbout::new(&bench.tool),
            arm: bench.arm.as_ref().map(|arm| ArmAbout::new(arm, bench, kept)),
            front_deg: bench.front_deg(),
            times_s: kept.iter().map(|frame| rounded(frame.time_s)).collect(),
            poses: kept.iter().map(|frame| numbers(&frame.tool)).collect(),
            planned: kept.iter().map(|frame| frame.planned.as_ref().map(numbers)).collect(),
            fastest_m_s: fastest.map(|fastest| f64::from(fastest) * SPEED_QUANTUM_M_S),
            destinations: known.then(|| destinations.iter().copied().map(digit).collect()),
        }
    }
}

impl ArmAbout {
    fn new(arm: &Arm, bench: &Bench, kept: &[Kept]) -> Self {
        // To a tenth of a millimetre: what is so large is not seen more exactly.
        let tenth_mm = |number: &f64| (number * 1e4).round() / 1e4;
        let ends = |capsule: &Capsule| capsule.ends_m.as_flattened().iter().map(tenth_mm).collect::<Vec<_>>();
        let moving = |time_s| arm.moving(time_s);
        let (standing, first) = (arm.standing(), moving(0.0));
        Self {
            name: arm.motion.model.kind.label(),
            radii_m: standing.iter().chain(&first).map(|capsule| capsule.radius_m).collect(),
            standing_m: standing.iter().flat_map(ends).collect(),
            moving_m: kept.iter().map(|frame| moving(frame.time_s).iter().flat_map(ends).collect()).collect(),
            stand_m: bench
                .stand()
                .and_then(|stand| Extent::about(stand.points_m))
                .map(|block| [block.low_m, block.high_m]),
        }
    }
}

impl MeshAbout {
    fn new(mesh: &Mesh) -> Self {
        Self {
            points_m: mesh.points_m.iter().flatten().copied().map(rounded).collect(),
            corners: mesh.triangles.iter().flatten().copied().collect(),
        }
    }
}

fn role_name(role: Role) -> &'static str {
    match role {
        Role::Source => "source",
        Role::Target => "target",
        Role::Bystander => "bystander",
    }
}

fn digit(destination: Destination) -> char {
    match destination {
        Destination::Source => '0',
        Destination::Target => '1',
        Destination::Tool => '2',
        Destination::Spilled => '3',
        Destination::Rims => '4',
        Destination::InFlight => '5',
    }
}

fn numbers(pose: &Pose) -> [f64; 7] {
    let ([x, y, z], turn) = (pose.position_m.into(), pose.orientation.coords);
    [x, y, z, turn.x, turn.y, turn.z, turn.w].map(rounded)
}

/// To micrometres, microseconds and microradians: fewer digits in the page.
fn rounded(number: f64) -> f64 {
    (number * 1e6).round() / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;
    use powderline_simulator::scene::GateOpening;
    use std::io::Read as _;

    fn bench(particles: usize, period_s: f64) -> Bench {
        Bench {
            name: "bench".into(),
            size_m: [0.4, 0.2, 0.3],
            extent: Extent { low_m: [0.0; 3], high_m: [0.4, 0.2, 0.3] },
            cell_m: 0.01,
            containers: Vec::new(),
            gates: Vec::new(),
            tool: Mesh::bowl(0.03, 0.002),
            arm: None,
            target_m: [0.3, 0.1, 0.0],
            particles,
            period_s,
            frames: 100,
        }
    }

    /// Anywhere in the volume; each particle steps differently.
    fn cloud(particles: usize, frame: usize) -> Vec<[f32; 3]> {
        let share =
            |at: usize, axis: usize| ((at * 7919 + frame * (at % 5) * 131 + axis * 31) % 1000) as f32 / 999.0;
        (0..particles).map(|at| [0.4 * share(at, 0), 0.2 * share(at, 1), 0.3 * share(at, 2)]).collect()
    }

    fn recorded(bench: &Bench, frames: usize, budget_bytes: usize) -> Recorder {
        let mut recorder = Recorder::with_budget(bench, budget_bytes);
        for index in 0..frames {
            let positions_m = cloud(bench.particles, index);
            let velocities_m_s = vec![[0.0, 0.3, 0.001 * index as f32]; bench.particles];
            let time_s = index as f64 * bench.period_s;
            let frame = Frame {
                index,
                time_s,
                tool: Pose::identity(),
                planned: None,
                positions_m: &positions_m,
                velocities_m_s: &velocities_m_s,
            };
            recorder.frame(&frame).expect("a recorder writes nothing");
        }
        recorder
    }

    /// What the page's script does: positions and speed codes, frame after frame.
    fn unpacked(replay: &Replay) -> Vec<(Vec<[u16; 3]>, Vec<u8>)> {
        let deflated = base64::engine::general_purpose::STANDARD.decode(&replay.powder).expect("base64");
        let mut bytes = Vec::new();
        flate2::read::ZlibDecoder::new(&deflated[..]).read_to_end(&mut bytes).expect("deflated");
        let count = replay.about.particles;
        let (mut positions, mut speeds) = (vec![[0_u16; 3]; count], vec![0_u8; count]);
        let bytes_each = if replay.about.fastest_m_s.is_some() { 7 } else { 6 };
        let frames = bytes.chunks_exact(bytes_each * count).map(|frame| {
            for at in 0..count {
                for axis in 0..3 {
                    let step = u16::from_le_bytes([
                        frame[2 * axis * count + at],
                        frame[(2 * axis + 1) * count + at],
                    ]);
                    let difference = (step >> 1) ^ (step & 1).wrapping_neg();
                    positions[at][axis] = positions[at][axis].wrapping_add(difference);
                }
                speeds[at] = speeds[at].wrapping_add(frame.get(6 * count + at).copied().unwrap_or_default());
            }
            (positions.clone(), speeds.clone())
        });
        frames.collect()
    }

    #[test]
    fn positions_come_back_within_half_a_step() {
        let bench = bench(500, 0.02);
        let replay = recorded(&bench, 20, usize::MAX).into_replay().expect("frames came");
        let frames = unpacked(&replay);
        assert_eq!(frames.len(), 20);
        for (index, (positions, _)) in frames.iter().enumerate() {
            for (position, truth) in positions.iter().zip(cloud(500, index)) {
                for axis in 0..3 {
                    let step_m = bench.size_m[axis] / STEPS;
                    let off_m = f64::from(position[axis]) * step_m - f64::from(truth[axis]);
                    assert!(off_m.abs() <= 0.5 * step_m + 1e-9, "{off_m} m in frame {index}");
                }
            }
        }
    }

    #[test]
    fn speeds_come_back_within_half_a_code() {
        let bench = bench(3, 0.02);
        let replay = recorded(&bench, 20, usize::MAX).into_replay().expect("frames came");
        let fastest = replay.about.fastest_m_s.expect("they fit");
        for (index, (_, speeds)) in unpacked(&replay).iter().enumerate() {
            let truth = 0.3_f64.hypot(0.001 * index as f64);
            let code = (truth / fastest).sqrt() * 255.0;
            assert!((f64::from(speeds[0]) - code).abs() < 0.6, "{} for {code}", speeds[0]);
        }
    }

    #[test]
    fn particles_outside_lie_on_the_border() {
        assert_eq!(steps([-1.0, 0.1, f32::NAN], [0.2; 3]), [0, 32768, 0]);
        assert_eq!(steps([f32::INFINITY, 0.3, 0.0], [0.2; 3]), [u16::MAX, u16::MAX, 0]);
    }

    #[test]
    fn fifty_frames_a_second_and_the_last() {
        let replay = recorded(&bench(4, 0.01), 100, usize::MAX).into_replay().expect("frames came");
        assert_eq!(replay.frames(), 51);
        let times_s = &replay.about.times_s;
        assert!((times_s[1] - 0.02).abs() < 1e-9 && (times_s[50] - 0.99).abs() < 1e-9, "{times_s:?}");
    }

    #[test]
    fn frames_are_left_out_until_the_rest_fits() {
        let recorder = recorded(&bench(300, 0.02), 101, usize::MAX);
        let all = recorder.clone().into_replay().expect("frames came").powder_bytes();
        let mut counts = Vec::new();
        for part in [1, 2, 4, 8] {
            let budgeted = Recorder { budget_bytes: all / part, ..recorder.clone() };
            let replay = budgeted.into_replay().expect("frames came");
            assert!(replay.powder_bytes() <= all / part);
            assert!((replay.about.times_s.last().expect("frames") - 2.0).abs() < 1e-9);
            assert_eq!(unpacked(&replay).len(), replay.frames());
            counts.push(replay.frames());
        }
        assert!(counts.is_sorted_by(|more, fewer| more > fewer), "{counts:?}");
        let least = Recorder { budget_bytes: 0, ..recorder }.into_replay().expect("frames came");
        assert_eq!(least.frames(), 2);
        assert!(least.about.fastest_m_s.is_none());
    }

    #[test]
    fn powder_at_rest_takes_next_to_nothing() {
        let bench = bench(1000, 0.02);
        let mut recorder = Recorder::new(&bench);
        let (positions_m, velocities_m_s) = (cloud(1000, 1), vec![[0.0; 3]; 1000]);
        for index in 0..100 {
            let (tool, time_s) = (Pose::identity(), index as f64 * 0.02);
            let (positions_m, velocities_m_s) = (&positions_m[..], &velocities_m_s[..]);
            let frame = Frame { index, time_s, tool, planned: None, positions_m, velocities_m_s };
            recorder.frame(&frame).expect("a recorder writes nothing");
        }
        let replay = recorder.into_replay().expect("frames came");
        assert_eq!(replay.frames(), 100);
        assert!(replay.powder_bytes() < 2 * 6 * 1000, "{}", replay.powder_bytes());
    }

    #[test]
    fn gates_are_told_where_they_are_in_each_frame_that_is_left() {
        let gate = crate::picture::sample::gate();
        let mut slid = gate.clone();
        slid.law.opening = GateOpening::Slide { velocity_m_s: [0.0, 0.0, 0.04], travel_m: 0.02 };
        let bench = Bench { gates: vec![gate, slid], ..bench(4, 0.01) };
        let replay = recorded(&bench, 100, usize::MAX).into_replay().expect("frames came");
        let [gone, moved] = [0, 1].map(|gate| &replay.about.gates[gate].moved_m);
        for (at, time_s) in replay.about.times_s.iter().enumerate() {
            let moved_m = rounded(0.04 * (time_s - 0.75).max(0.0));
            assert_eq!(gone[at], (*time_s < 0.7499).then_some([0.0; 3]), "{time_s} s");
            assert_eq!(moved[at], Some([0.0, 0.0, moved_m]), "{time_s} s");
        }
        assert_eq!([gone.len(), moved.len()], [51; 2]);
    }

    #[test]
    fn frames_of_another_length_and_none_at_all() {
        let bench = bench(5, 0.02);
        assert!(Recorder::new(&bench).into_replay().is_none());
        let mut recorder = recorded(&bench, 1, usize::MAX);
        let frame = Frame {
            index: 1,
            time_s: 0.02,
            tool: Pose::identity(),
            planned: Some(Pose::identity()),
            positions_m: &[[0.1; 3]; 9],
            velocities_m_s: &[],
        };
        recorder.frame(&frame).expect("a recorder writes nothing");
        recorder.finish(&[Destination::Source]).expect("a recorder writes nothing");
        let replay = recorder.into_replay().expect("frames came");
        assert_eq!(unpacked(&replay).len(), 2);
        assert!(replay.about.destinations.is_none());
    }
}
