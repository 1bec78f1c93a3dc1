//! Grid update: momentum to velocity, gravity, contact at the nodes.

use crate::mpm::Model;
use crate::mpm::contact::{BodyState, BodyStateBar, ContactParams, contact, contact_adjoint};
use crate::mpm::layout::{BLOCK_EDGE, BLOCK_NODES, NodeBlock, Nodes};
use crate::mpm::obstacle::{Collider, NearbyCollider};
use crate::mpm::particles::{LANES, Lanes, set_vec, vec_of};
use crate::mpm::sleep::wakes;
use crate::mpm::tiles::Tiles;
use crate::real::Real;
use crate::shape::{SignedDistance, with_solid};
use crate::small::{sub, three, tr_mul_vec};

/// Groups of lanes in a block's nodes.
const CHUNKS: usize = BLOCK_NODES / LANES;

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
    pub(crate) tool: &'a BodyState<T>,
    pub(crate) node: &'a NodeBlock,
    pub(crate) tiles: Tiles<'a, T>,
    /// Momentum and mass.
    pub(crate) momentum: &'a mut Nodes<T>,
    pub(crate) velocity: &'a mut Nodes<T>,
}

impl<T: Real> pulp::NullaryFnOnce for UpdateNodes<'_, T> {
    /// Whether any node moves too fast for sleepers.
    type Output = bool;

    #[inline(always)]
    fn call(self) -> bool {
        if !self.tiles.any_awake(self.node) {
            return false;
        }
        *self.momentum = self.tiles.sum(self.node);
        if !any_mass(self.momentum) {
            *self.velocity = [[T::ZERO; 4]; BLOCK_NODES];
            return false;
        }
        let mut v = free_velocity(self.model, self.momentum);
        let touching = self.model.obstacles.at_nodes(&self.model.grid, self.node.coord, self.tool);
        if !touching.is_empty() {
            let x = positions(self.model, self.node);
            for ((x, v), nodes) in x.iter().zip(&mut v).zip(self.momentum.chunks(LANES)) {
                if any_mass(nodes) {
                    for t in &touching {
                        contact_lanes(t, &t.piece.node_law, x, v);
                    }
                }
            }
        }
        for (n, out) in self.velocity.iter_mut().enumerate() {
            let lanes = &v[n / LANES];
            *out = [lanes[0][n % LANES], lanes[1][n % LANES], lanes[2][n % LANES], T::ZERO];
        }
        self.model.sleep_speed > T::ZERO
            && self.velocity.iter().zip(self.momentum).any(|(v, p)| p[3] > T::ZERO && wakes(self.model, v))
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

/// Adjoint of [`UpdateNodes`]: from the tiles of velocity cotangents to cotangents of momentum and mass, and of the
/// tool's motion.
pub(crate) struct UpdateNodesAdjoint<'a, T> {
    pub(crate) model: &'a Model<T>,
    pub(crate) tool: &'a BodyState<T>,
    pub(crate) node: &'a NodeBlock,
    pub(crate) velocity_bar_tiles: Tiles<'a, T>,
    pub(crate) momentum: &'a Nodes<T>,
    pub(crate) momentum_bar: &'a mut Nodes<T>,
}

impl<T: Real> pulp::NullaryFnOnce for UpdateNodesAdjoint<'_, T> {
    type Output = BodyStateBar;

    #[inline(always)]
    fn call(self) -> BodyStateBar {
        if !self.velocity_bar_tiles.any_awake(self.node) {
            return BodyStateBar::default();
        }
        if !any_mass(self.momentum) {
            *self.momentum_bar = [[T::ZERO; 4]; BLOCK_NODES];
            return BodyStateBar::default();
        }
        let incoming = self.velocity_bar_tiles.sum(self.node);
        let mut bar = [[Lanes::ZERO; 3]; CHUNKS];
        for (n, b) in incoming.iter().enumerate() {
            set_vec(&mut bar[n / LANES], n % LANES, [b[0], b[1], b[2]]);
        }
        let mut tool_bar = BodyStateBar::default();
        let touching = self.model.obstacles.at_nodes(&self.model.grid, self.node.coord, self.tool);
        if !touching.is_empty() {
            let x = positions(self.model, self.node);
            let v = free_velocity(self.model, self.momentum);
            let mut met = Vec::with_capacity(touching.len());
            for (((x, v), bar), nodes) in x.iter().zip(v).zip(&mut bar).zip(self.momentum.chunks(LANES)) {
                if !any_mass(nodes) {
                    continue;
                }
                find_near(&touching, |piece| &piece.node_law, x, &mut met);
                meet(&mut met, x, v);
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
        tool_bar
    }
}

/// Whether any of [`LANES`] points is within the reach of a piece. Beyond it contact changes nothing, exactly.
#[inline(always)]
fn is_near<T: Real>(t: &NearbyCollider<'_, T>, law: &ContactParams<T>, x: &[Lanes<T>; 3]) -> bool {
    let mut near = Lanes::ZERO;
    with_solid!(t.piece.shape, solid => {
        for l in 0..LANES {
            let y = tr_mul_vec(&t.motion.rotation, sub(vec_of(x, l), t.motion.position));
            near[l] = T::ONE.only_if(solid.distance::<T>(y).0 < law.reach());
        }
    });
    near.iter().any(|n| *n > T::ZERO)
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

/// A piece that [`LANES`] points met, and their velocities just before.
pub(crate) struct ContactRecord<'a, T> {
    touching: NearbyCollider<'a, T>,
    law: &'a ContactParams<T>,
    before: [Lanes<T>; 3],
}

/// Notes the pieces that are within reach.
#[inline(always)]
pub(crate) fn find_near<'a, T: Real>(
    touching: &[NearbyCollider<'a, T>],
    law: impl Fn(&'a Collider<T>) -> &'a ContactParams<T>,
    x: &[Lanes<T>; 3],
    met: &mut Vec<ContactRecord<'a, T>>,
) {
    met.clear();
    for t in touching {
        let law = law(t.piece);
        if is_near(t, law, x) {
            met.push(ContactRecord { touching: *t, law, before: [Lanes::ZERO; 3] });
        }
    }
}

/// Runs through these pieces from velocity `v`.
#[inline(always)]
pub(crate) fn meet<T: Real>(met: &mut [ContactRecord<'_, T>], x: &[Lanes<T>; 3], mut v: [Lanes<T>; 3]) {
    for m in met {
        m.before = v;
        v = after_contact(&m.touching, m.law, x, &m.before);
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
    let ContactRecord { touching: t, law, before: v } = met;
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
    *bar = bar_before;
    if let Some(x_bar) = x_bar {
        for i in 0..3 {
            for l in 0..LANES {
                x_bar[i][l] += sums[i][l];
            }
        }
    }
    if t.moving {
        let total = |i: usize| sums[i].iter().map(|x| x.to_f64()).sum::<f64>();
        for i in 0..3 {
            tool_bar.position[i] -= total(i);
            tool_bar.rotation[i] += total(3 + i);
            tool_bar.velocity[i] += total(6 + i);
            tool_bar.angular_velocity[i] += total(9 + i);
        }
    }
}
