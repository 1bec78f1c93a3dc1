//! Grid update: momentum to velocity, gravity, contact at the nodes; and the density there, if volume is held to it.

use smallvec::SmallVec;

use crate::mpm::Model;
use crate::mpm::bodies::Bodies;
use crate::mpm::contact::{BodyStateBar, ContactParams, contact, contact_adjoint};
use crate::mpm::density::inverse_room;
use crate::mpm::layout::{BLOCK_EDGE, BLOCK_NODES, NodeBlock, Nodes, Side};
use crate::mpm::obstacle::{Collider, Colliders, NearbyCollider, USUALLY_NEAR, room_of};
use crate::mpm::particles::{LANES, Lanes, set_vec, vec_of};
use crate::mpm::residue::{unforced_velocity, unforced_velocity_adjoint};
use crate::mpm::stencil::Tile;
use crate::mpm::tiles::Tiles;
use crate::real::Real;
use crate::shape::{SignedDistance, with_solid};
use crate::small::{cross, mul_vec, scale, sub, three, tr_mul_vec};

/// Groups of lanes in a block's nodes.
pub(crate) const CHUNKS: usize = BLOCK_NODES / LANES;

/// Positions or velocities of a block's nodes.
pub(crate) type NodeLanes<T> = [[Lanes<T>; 3]; CHUNKS];

/// Positions of a block's nodes from its first one, m.
pub(crate) fn node_places<T: Real>(dx: T) -> NodeLanes<T> {
    let mut x = [[Lanes::ZERO; 3]; CHUNKS];
    for n in 0..BLOCK_NODES {
        let ijk = [n / (BLOCK_EDGE * BLOCK_EDGE), n / BLOCK_EDGE % BLOCK_EDGE, n % BLOCK_EDGE];
        for axis in 0..3 {
            x[n / LANES][axis][n % LANES] = dx * T::from_f64(ijk[axis] as f64);
        }
    }
    x
}

/// Whether any of some nodes has mass. Those without are no particle's, and whatever happens to them is without effect.
#[inline(always)]
fn any_mass<T: Real>(nodes: &[[T; 4]]) -> bool {
    nodes.iter().any(|node| node[3] > T::ZERO)
}

/// Sums one node block's tiles and finds its velocities after gravity and contact. Where all sleep, nothing is done.
pub(crate) struct UpdateNodes<'a, T> {
    pub(crate) model: &'a Model<T>,
    pub(crate) bodies: &'a Bodies<T>,
    pub(crate) node: &'a NodeBlock,
    pub(crate) tiles: Tiles<'a, T>,
    /// Whether volumes are held in this substep.
    pub(crate) holds_volume: bool,
    /// Momentum and mass.
    pub(crate) momentum: &'a mut Nodes<T>,
    /// Velocity, and density where volume is held to it.
    pub(crate) velocity: &'a mut Nodes<T>,
    /// Where the velocity residue is given back: the tiles of momentum without forces of those who are awake, and for the velocities
    /// of that momentum.
    pub(crate) unforced: Option<(&'a [Tile<T>], &'a mut Nodes<T>)>,
}

impl<T: Real> pulp::NullaryFnOnce for UpdateNodes<'_, T> {
    /// Whether any node moves so fast that it can wake sleepers.
    type Output = bool;

    #[inline(always)]
    fn call(self) -> bool {
        if !self.tiles.any_awake(self.node) {
            return false;
        }
        self.tiles.sum(self.node, self.momentum);
        if !any_mass(self.momentum) {
            *self.velocity = [[T::ZERO; 4]; BLOCK_NODES];
            if let Some((_, unforced)) = self.unforced {
                *unforced = [[T::ZERO; 4]; BLOCK_NODES];
            }
            return false;
        }
        if let Some((tiles, unforced)) = self.unforced {
            Tiles { fresh: tiles, sleepers_send: false, ..self.tiles }.sum(self.node, unforced);
            for (unforced, momentum) in unforced.iter_mut().zip(&*self.momentum) {
                *unforced = unforced_velocity(*unforced, momentum[3]);
            }
        }
        let mut v = free_velocity(self.model, self.momentum);
        let touching = self.model.obstacles.at_nodes(&self.model.grid, self.node, self.bodies);
        let mut meetings = Meetings::new(&self.model.obstacles, &touching, &self.node.sides);
        if !touching.is_empty() {
            let x = positions(self.model, self.node);
            for (chunk, (v, nodes)) in v.iter_mut().zip(self.momentum.chunks(LANES)).enumerate() {
                if any_mass(nodes) {
                    for m in meetings.of(chunk) {
                        contact_of_some(m, &m.with.piece.node_law, &x[chunk], v);
                    }
                }
            }
        }
        for (n, out) in self.velocity.iter_mut().enumerate() {
            let lanes = &v[n / LANES];
            *out = [lanes[0][n % LANES], lanes[1][n % LANES], lanes[2][n % LANES], T::ZERO];
        }
        if self.holds_volume {
            let rooms = inverse_rooms(self.model, self.bodies, self.node, &mut meetings);
            for (n, (out, momentum)) in self.velocity.iter_mut().zip(&*self.momentum).enumerate() {
                out[3] = self.model.density_per_mass * momentum[3] * rooms[n / LANES][n % LANES];
            }
        }
        let sleep = &self.model.sleep;
        sleep.may_sleep()
            && self
                .velocity
                .iter()
                .zip(self.momentum)
                .any(|(v, p)| sleep.has_weight(p[3]) && sleep.can_wake(v))
    }
}

#[inline(always)]
fn free_velocity<T: Real>(model: &Model<T>, momentum: &Nodes<T>) -> NodeLanes<T> {
    let mut v = [[Lanes::ZERO; 3]; CHUNKS];
    for (chunk, out) in v.iter_mut().enumerate() {
        for l in 0..LANES {
            let [px, py, pz, m] = momentum[chunk * LANES + l];
            let inverse = if m > T::ZERO { T::ONE / m } else { T::ZERO };
            let g = model.gravity_dt;
            set_vec(out, l, [px * inverse + g[0], py * inverse + g[1], pz * inverse + g[2]]);
        }
    }
    v
}

#[inline(always)]
fn positions<T: Real>(model: &Model<T>, node: &NodeBlock) -> NodeLanes<T> {
    let origin = model.grid.block_origin(node.coord).map(T::from_f64);
    let mut x = model.node_places;
    for chunk in &mut x {
        for axis in 0..3 {
            for l in 0..LANES {
                chunk[axis][l] = origin[axis] + chunk[axis][l];
            }
        }
    }
    x
}

/// A piece, or a face of it that goes on beyond its edges, and which of [`LANES`] points meet it.
#[derive(Clone, Copy)]
pub(crate) struct Meeting<'a, T> {
    with: NearbyCollider<'a, T>,
    /// They are behind it.
    is_behind: bool,
    /// Bit `l` for lane `l`.
    lanes: u16,
}

impl<'a, T: Real> Meeting<'a, T> {
    /// Of all points with a piece as it is.
    #[inline(always)]
    pub(crate) fn of_all(with: NearbyCollider<'a, T>) -> Self {
        Self { with, is_behind: false, lanes: u16::MAX }
    }

    #[inline(always)]
    fn has(&self, l: usize) -> bool {
        self.lanes >> l & 1 == 1
    }
}

/// What the nodes of a block meet, in the order of pieces: those behind a face meet the face, those in a solid that is hidden from beyond
/// its edge do not meet it.
struct Meetings<'a, T> {
    obstacles: &'a Colliders<T>,
    touching: &'a [NearbyCollider<'a, T>],
    sides: &'a [Side],
    /// Of which nodes these are.
    chunk: Option<usize>,
    found: SmallVec<[Meeting<'a, T>; USUALLY_NEAR]>,
}

impl<'a, T: Real> Meetings<'a, T> {
    #[inline(always)]
    fn new(obstacles: &'a Colliders<T>, touching: &'a [NearbyCollider<'a, T>], sides: &'a [Side]) -> Self {
        Self { obstacles, touching, sides, chunk: None, found: SmallVec::new() }
    }

    /// Those of one of the block's [`CHUNKS`].
    #[inline(always)]
    fn of(&mut self, chunk: usize) -> &[Meeting<'a, T>] {
        if self.chunk != Some(chunk) && (self.chunk.is_none() || !self.sides.is_empty()) {
            self.find(chunk);
        }
        self.chunk = Some(chunk);
        &self.found
    }

    fn find(&mut self, chunk: usize) {
        self.found.clear();
        for t in self.touching {
            let mut others = u16::MAX;
            for side in self.sides.iter().filter(|side| side.of.piece == t.number) {
                let lanes = (side.nodes >> (chunk * LANES)) as u16;
                others &= !lanes;
                let face = self.obstacles.face(t.number, side.of.face).filter(|_| lanes != 0);
                let behind = |piece| Meeting { with: NearbyCollider { piece, ..*t }, is_behind: true, lanes };
                self.found.extend(face.map(behind));
            }
            if others != 0 {
                self.found.push(Meeting { with: *t, is_behind: false, lanes: others });
            }
        }
    }
}

/// `1/a` of a block's nodes.
#[inline(always)]
fn inverse_rooms<T: Real>(
    model: &Model<T>,
    bodies: &Bodies<T>,
    node: &NodeBlock,
    meetings: &mut Meetings<'_, T>,
) -> [Lanes<T>; CHUNKS] {
    let mut rooms = rooms(model, bodies, node, meetings);
    for lanes in &mut rooms {
        for l in 0..LANES {
            lanes[l] = inverse_room(lanes[l]).0;
        }
    }
    rooms
}

/// `a` of a block's nodes: what the fixed pieces leave of their room is known, unless a node is behind one of them, and the moving ones
/// take theirs from it.
#[inline(always)]
fn rooms<T: Real>(
    model: &Model<T>,
    bodies: &Bodies<T>,
    node: &NodeBlock,
    meetings: &mut Meetings<'_, T>,
) -> [Lanes<T>; CHUNKS] {
    let mut out = [Lanes([T::ONE; LANES]); CHUNKS];
    if let Some(rooms) = model.obstacles.rooms(&model.grid, node.coord) {
        for (n, room) in rooms.iter().enumerate() {
            out[n / LANES][n % LANES] = *room;
        }
    }
    let moved = meetings.touching.iter().any(|t| !t.is_fixed);
    let behind = node.sides.iter().filter(|side| model.obstacles.is_fixed(side.of.piece));
    let behind = behind.fold(0, |nodes, side| nodes | side.nodes);
    if !moved && behind == 0 {
        return out;
    }
    let x = positions(model, node);
    if behind != 0 {
        let touching = model.obstacles.taking_room(&model.grid, node, bodies);
        let mut fixed = Meetings::new(&model.obstacles, &touching, &node.sides);
        for (chunk, (x, out)) in x.iter().zip(&mut out).enumerate() {
            let lanes = (behind >> (chunk * LANES)) as u16;
            if lanes == 0 {
                continue;
            }
            let mut known = *out;
            for l in 0..LANES {
                known[l] = if lanes >> l & 1 == 1 { T::ONE } else { known[l] };
            }
            for m in fixed.of(chunk).iter().filter(|m| m.with.is_fixed) {
                known = take_room(&Meeting { lanes: m.lanes & lanes, ..*m }, model.inverse_dx, x, &known);
            }
            *out = known;
        }
    }
    for (chunk, (x, out)) in x.iter().zip(&mut out).enumerate().filter(|_| moved) {
        for m in meetings.of(chunk).iter().filter(|m| !m.with.is_fixed) {
            *out = take_room(m, model.inverse_dx, x, out);
        }
    }
    out
}

/// The room that a piece leaves of what there is.
#[inline(always)]
fn take_room<T: Real>(m: &Meeting<'_, T>, inverse_dx: T, x: &[Lanes<T>; 3], rooms: &Lanes<T>) -> Lanes<T> {
    if m.with.piece.is_two_sided {
        room_left::<T, true>(m, inverse_dx, x, rooms)
    } else {
        room_left::<T, false>(m, inverse_dx, x, rooms)
    }
}

#[inline(always)]
fn room_left<T: Real, const TWO_SIDED: bool>(
    m: &Meeting<'_, T>,
    inverse_dx: T,
    x: &[Lanes<T>; 3],
    rooms: &Lanes<T>,
) -> Lanes<T> {
    let mut left = *rooms;
    let t = &m.with;
    with_solid!(t.piece.shape, solid => {
        for l in 0..LANES {
            let y = tr_mul_vec(&t.motion.rotation, sub(vec_of(x, l), t.motion.position));
            let (_, (room, _)) = room_of::<T, _, TWO_SIDED>(&solid, inverse_dx, y);
            left[l] = rooms[l] * if m.has(l) { room } else { T::ONE };
        }
    });
    left
}

/// Adjoint of the densities: adds to the masses' cotangents, and to the tool's for the room that it takes.
#[inline(always)]
fn density_adjoint<T: Real>(
    model: &Model<T>,
    (bodies, node): (&Bodies<T>, &NodeBlock),
    meetings: &mut Meetings<'_, T>,
    [momentum, density_bar]: [&Nodes<T>; 2],
    momentum_bar: &mut Nodes<T>,
    tool_bar: &mut BodyStateBar,
) {
    let rooms = rooms(model, bodies, node, meetings);
    for n in 0..BLOCK_NODES {
        let (inverse, _) = inverse_room(rooms[n / LANES][n % LANES]);
        let mass_bar = model.density_per_mass * inverse * density_bar[n][3];
        momentum_bar[n][3] += mass_bar.only_if(momentum[n][3] > T::ZERO);
    }
    if !meetings.touching.iter().any(|t| t.of_tool) {
        return;
    }
    for (chunk, x) in positions(model, node).iter().enumerate() {
        // Cotangent of the logarithm of the room: the density is mass over room.
        let mut log_bar = Lanes::ZERO;
        for l in 0..LANES {
            let (n, (inverse, is_least)) = (chunk * LANES + l, inverse_room(rooms[chunk][l]));
            let density = model.density_per_mass * momentum[n][3] * inverse;
            log_bar[l] = -(density * density_bar[n][3]).only_if(!is_least);
        }
        for m in meetings.of(chunk).iter().filter(|m| m.with.of_tool) {
            take_room_adjoint(m, model.inverse_dx, x, &log_bar, tool_bar);
        }
    }
}

/// Adjoint of [`take_room`] for the logarithm of the room.
#[inline(always)]
fn take_room_adjoint<T: Real>(
    m: &Meeting<'_, T>,
    inverse_dx: T,
    x: &[Lanes<T>; 3],
    log_bar: &Lanes<T>,
    tool_bar: &mut BodyStateBar,
) {
    if m.with.piece.is_two_sided {
        room_left_adjoint::<T, true>(m, inverse_dx, x, log_bar, tool_bar);
    } else {
        room_left_adjoint::<T, false>(m, inverse_dx, x, log_bar, tool_bar);
    }
}

#[inline(always)]
fn room_left_adjoint<T: Real, const TWO_SIDED: bool>(
    m: &Meeting<'_, T>,
    inverse_dx: T,
    x: &[Lanes<T>; 3],
    log_bar: &Lanes<T>,
    tool_bar: &mut BodyStateBar,
) {
    let t = &m.with;
    let mut sums = [Lanes::ZERO; 6];
    with_solid!(t.piece.shape, solid => {
        for l in 0..LANES {
            let arm = sub(vec_of(x, l), t.motion.position);
            let y = tr_mul_vec(&t.motion.rotation, arm);
            let (normal, (left, slope)) = room_of::<T, _, TWO_SIDED>(&solid, inverse_dx, y);
            let least = T::from_f64(1e-6);
            let s_bar = (inverse_dx * log_bar[l] * slope / left.at_least(least)).only_if(m.has(l));
            let g = scale(s_bar, mul_vec(&t.motion.rotation, normal));
            let turn = cross(g, arm);
            for i in 0..3 {
                sums[i][l] = g[i];
                sums[3 + i][l] = turn[i];
            }
        }
    });
    let total = |i: usize| sums[i].iter().map(|x| x.to_f64()).sum::<f64>();
    for i in 0..3 {
        tool_bar.position[i] -= total(i);
        tool_bar.rotation[i] += total(3 + i);
    }
}

/// Adjoint of [`UpdateNodes`]: from the tiles of velocity cotangents to cotangents of momentum and mass, and of the
/// tool's motion.
pub(crate) struct UpdateNodesAdjoint<'a, T> {
    pub(crate) model: &'a Model<T>,
    pub(crate) bodies: &'a Bodies<T>,
    pub(crate) node: &'a NodeBlock,
    pub(crate) velocity_bar_tiles: Tiles<'a, T>,
    /// Whether volumes were held in this substep.
    pub(crate) holds_volume: bool,
    pub(crate) momentum: &'a Nodes<T>,
    pub(crate) momentum_bar: &'a mut Nodes<T>,
    pub(crate) unforced: Option<UnforcedNodesBar<'a, T>>,
}

/// Where the velocity residue is given back: what is to be known for the cotangents of the nodes' momentum without forces.
pub(crate) struct UnforcedNodesBar<'a, T> {
    /// Of the velocities, of those who are awake.
    pub(crate) tiles: &'a [Tile<T>],
    /// Velocities.
    pub(crate) velocity: &'a Nodes<T>,
    /// For the cotangents of the momentum; as fourth numbers, what is added to those of mass.
    pub(crate) bar: &'a mut Nodes<T>,
}

impl<T: Real> pulp::NullaryFnOnce for UpdateNodesAdjoint<'_, T> {
    type Output = BodyStateBar;

    #[inline(always)]
    fn call(self) -> BodyStateBar {
        if !self.velocity_bar_tiles.any_awake(self.node) {
            return BodyStateBar::default();
        }
        let of_unforced = self.unforced.map(|UnforcedNodesBar { tiles, velocity, bar }| {
            Tiles { fresh: tiles, ..self.velocity_bar_tiles }.sum(self.node, bar);
            for ((bar, velocity), momentum) in bar.iter_mut().zip(velocity).zip(self.momentum) {
                *bar = unforced_velocity_adjoint(*velocity, momentum[3], *bar);
            }
            &*bar
        });
        if !any_mass(self.momentum) {
            *self.momentum_bar = [[T::ZERO; 4]; BLOCK_NODES];
            return BodyStateBar::default();
        }
        let mut incoming = [[T::ZERO; 4]; BLOCK_NODES];
        self.velocity_bar_tiles.sum(self.node, &mut incoming);
        let mut bar = [[Lanes::ZERO; 3]; CHUNKS];
        for (n, b) in incoming.iter().enumerate() {
            set_vec(&mut bar[n / LANES], n % LANES, [b[0], b[1], b[2]]);
        }
        let mut tool_bar = BodyStateBar::default();
        let touching = self.model.obstacles.at_nodes(&self.model.grid, self.node, self.bodies);
        let mut meetings = Meetings::new(&self.model.obstacles, &touching, &self.node.sides);
        if !touching.is_empty() {
            let x = positions(self.model, self.node);
            let v = free_velocity(self.model, self.momentum);
            let mut met = Vec::with_capacity(touching.len());
            for (chunk, (bar, nodes)) in bar.iter_mut().zip(self.momentum.chunks(LANES)).enumerate() {
                if !any_mass(nodes) {
                    continue;
                }
                let x = &x[chunk];
                find_near(meetings.of(chunk).iter().copied(), |piece| &piece.node_law, x, &mut met);
                meet(&mut met, x, v[chunk]);
                for m in met.iter().rev() {
                    contact_lanes_adjoint(m, x, bar, None, &mut tool_bar);
                }
            }
        }
        for (n, out) in self.momentum_bar.iter_mut().enumerate() {
            let b = vec_of(&bar[n / LANES], n % LANES);
            let [px, py, pz, m] = self.momentum[n];
            let inverse = if m > T::ZERO { T::ONE / m } else { T::ZERO };
            let p_bar = three!(i => b[i] * inverse);
            let m_bar = -((p_bar[0] * px + p_bar[1] * py + p_bar[2] * pz) * inverse);
            *out = [p_bar[0], p_bar[1], p_bar[2], m_bar];
        }
        for (out, of_unforced) in self.momentum_bar.iter_mut().zip(of_unforced.into_iter().flatten()) {
            out[3] += of_unforced[3];
        }
        if self.holds_volume {
            let (momentum, out) = ([self.momentum, &incoming], &mut *self.momentum_bar);
            let on = (self.bodies, self.node);
            density_adjoint(self.model, on, &mut meetings, momentum, out, &mut tool_bar);
        }
        tool_bar
    }
}

/// Which of [`LANES`] points are within the reach of a piece: 1 for those. Beyond it contact changes nothing, exactly.
#[inline(always)]
fn near<T: Real>(t: &NearbyCollider<'_, T>, law: &ContactParams<T>, x: &[Lanes<T>; 3]) -> Lanes<T> {
    let mut near = Lanes::ZERO;
    with_solid!(t.piece.shape, solid => {
        for l in 0..LANES {
            let y = tr_mul_vec(&t.motion.rotation, sub(vec_of(x, l), t.motion.position));
            near[l] = T::ONE.only_if(solid.distance::<T>(y).0 < law.reach());
        }
    });
    near
}

/// Whether any of the points is.
#[inline(always)]
fn is_near<T: Real>(t: &NearbyCollider<'_, T>, law: &ContactParams<T>, x: &[Lanes<T>; 3]) -> bool {
    near(t, law, x).iter().any(|n| *n > T::ZERO)
}

/// The same of those that meet it.
#[inline(always)]
fn some_near<T: Real>(m: &Meeting<'_, T>, law: &ContactParams<T>, x: &[Lanes<T>; 3]) -> bool {
    let near = near(&m.with, law, x);
    (0..LANES).any(|l| m.has(l) && near[l] > T::ZERO)
}

/// Contact of [`LANES`] points with one piece.
#[inline(always)]
pub(crate) fn contact_lanes<T: Real>(
    t: &NearbyCollider<'_, T>,
    law: &ContactParams<T>,
    x: &[Lanes<T>; 3],
    v: &mut [Lanes<T>; 3],
) {
    if is_near(t, law, x) {
        *v = after_contact(t, law, x, v);
    }
}

/// Returns a new value, which cannot alias the input: otherwise the loop would not vectorise.
#[inline(always)]
fn after_contact<T: Real>(
    t: &NearbyCollider<'_, T>,
    law: &ContactParams<T>,
    x: &[Lanes<T>; 3],
    v: &[Lanes<T>; 3],
) -> [Lanes<T>; 3] {
    let mut after = *v;
    with_solid!(t.piece.shape, solid => {
        for l in 0..LANES {
            set_vec(&mut after, l, contact(&solid, t.motion, law, vec_of(x, l), vec_of(v, l)));
        }
    });
    after
}

/// The same for some of the points.
#[inline(always)]
fn contact_of_some<T: Real>(
    m: &Meeting<'_, T>,
    law: &ContactParams<T>,
    x: &[Lanes<T>; 3],
    v: &mut [Lanes<T>; 3],
) {
    if m.lanes == u16::MAX {
        contact_lanes(&m.with, law, x, v);
    } else if m.is_behind || some_near(m, law, x) {
        *v = after_meeting(m, law, x, v);
    }
}

#[inline(always)]
fn after_meeting<T: Real>(
    m: &Meeting<'_, T>,
    law: &ContactParams<T>,
    x: &[Lanes<T>; 3],
    v: &[Lanes<T>; 3],
) -> [Lanes<T>; 3] {
    let mut after = after_contact(&m.with, law, x, v);
    for axis in 0..3 {
        for l in 0..LANES {
            after[axis][l] = if m.has(l) { after[axis][l] } else { v[axis][l] };
        }
    }
    after
}

/// A piece that some of [`LANES`] points met, and their velocities just before.
pub(crate) struct ContactRecord<'a, T> {
    meeting: Meeting<'a, T>,
    law: &'a ContactParams<T>,
    before: [Lanes<T>; 3],
}

/// Notes the pieces that are within reach.
#[inline(always)]
pub(crate) fn find_near<'a, T: Real>(
    meetings: impl Iterator<Item = Meeting<'a, T>>,
    law: impl Fn(&'a Collider<T>) -> &'a ContactParams<T>,
    x: &[Lanes<T>; 3],
    met: &mut Vec<ContactRecord<'a, T>>,
) {
    met.clear();
    for meeting in meetings {
        let law = law(meeting.with.piece);
        if meeting.is_behind || some_near(&meeting, law, x) {
            met.push(ContactRecord { meeting, law, before: [Lanes::ZERO; 3] });
        }
    }
}

/// Runs through these pieces from velocity `v`.
#[inline(always)]
pub(crate) fn meet<T: Real>(met: &mut [ContactRecord<'_, T>], x: &[Lanes<T>; 3], mut v: [Lanes<T>; 3]) {
    for m in met {
        m.before = v;
        v = after_meeting(&m.meeting, m.law, x, &m.before);
    }
}

/// Adjoint of contact for [`LANES`] points: `bar` goes from the velocity after contact to the one before;
/// positions' and the tool's cotangents are added to.
#[inline(always)]
pub(crate) fn contact_lanes_adjoint<T: Real>(
    met: &ContactRecord<'_, T>,
    x: &[Lanes<T>; 3],
    bar: &mut [Lanes<T>; 3],
    x_bar: Option<&mut [Lanes<T>; 3]>,
    tool_bar: &mut BodyStateBar,
) {
    let ContactRecord { meeting, law, before: v } = met;
    let t = &meeting.with;
    // Here the loop stays scalar without copies of all that is read, too.
    let (motion, law, x, v, bar_after) = (*t.motion, **law, *x, *v, *bar);
    let mut bar_before = bar_after;
    let mut sums = [Lanes::ZERO; 12];
    with_solid!(t.piece.shape, solid => {
        for l in 0..LANES {
            let b = contact_adjoint(&solid, &motion, &law, vec_of(&x, l), vec_of(&v, l), vec_of(&bar_after, l));
            set_vec(&mut bar_before, l, b.v);
            for i in 0..3 {
                sums[i][l] = b.x[i];
                sums[3 + i][l] = b.rotation[i];
                sums[6 + i][l] = b.velocity[i];
                sums[9 + i][l] = b.angular_velocity[i];
            }
        }
    });
    if meeting.lanes != u16::MAX {
        for l in (0..LANES).filter(|l| !meeting.has(*l)) {
            set_vec(&mut bar_before, l, vec_of(&bar_after, l));
            sums.iter_mut().for_each(|sum| sum[l] = T::ZERO);
        }
    }
    *bar = bar_before;
    if let Some(x_bar) = x_bar {
        for i in 0..3 {
            for l in 0..LANES {
                x_bar[i][l] += sums[i][l];
            }
        }
    }
    if t.of_tool {
        let total = |i: usize| sums[i].iter().map(|x| x.to_f64()).sum::<f64>();
        for i in 0..3 {
            tool_bar.position[i] -= total(i);
            tool_bar.rotation[i] += total(3 + i);
            tool_bar.velocity[i] += total(6 + i);
            tool_bar.angular_velocity[i] += total(9 + i);
        }
    }
}
