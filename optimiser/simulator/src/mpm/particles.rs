//! The powder's state: particles in groups of [`LANES`], structure of arrays inside a group.

use std::ops::{Deref, DerefMut};
use std::sync::Arc;

use crate::real::{Real, RealOps};
use crate::small::{Mat3, Sym3, Vec3};

/// Particles in a group. A loop over the lanes of a group is what the compiler turns into vector instructions.
pub(crate) const LANES: usize = 16;

/// One number for each particle of a group. Aligned, wherever it is, as vectors are: those that straddle two lines of the
/// cache take twice as long.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
pub(crate) struct Lanes<T>(pub(crate) [T; LANES]);

impl<T: Real> Lanes<T> {
    pub(crate) const ZERO: Self = Self([T::ZERO; LANES]);
}

impl<T> Deref for Lanes<T> {
    type Target = [T; LANES];

    #[inline(always)]
    fn deref(&self) -> &[T; LANES] {
        &self.0
    }
}

impl<T> DerefMut for Lanes<T> {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [T; LANES] {
        &mut self.0
    }
}

/// A lane that holds no particle.
pub(crate) const EMPTY_LANE: u32 = u32::MAX;

/// State of [`LANES`] particles, or their cotangents.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Group<T> {
    /// Position, m.
    pub(crate) x: [Lanes<T>; 3],
    /// Velocity, m/s.
    pub(crate) v: [Lanes<T>; 3],
    /// Affine velocity, 1/s, row-major.
    pub(crate) c: [Lanes<T>; 9],
    /// Elastic strain `b^e - I`: xx, yy, zz, xy, xz, yz.
    pub(crate) strain: [Lanes<T>; 6],
    /// Volume correction.
    pub(crate) q: [Lanes<T>; 1],
}

impl<T: Real> Group<T> {
    pub(crate) const ZERO: Self = Self {
        x: [Lanes::ZERO; 3],
        v: [Lanes::ZERO; 3],
        c: [Lanes::ZERO; 9],
        strain: [Lanes::ZERO; 6],
        q: [Lanes::ZERO; 1],
    };

    /// The same with nothing in motion.
    pub(crate) fn at_rest(&self) -> Self {
        Self { v: [Lanes::ZERO; 3], c: [Lanes::ZERO; 9], ..*self }
    }

    /// The 22 rows of numbers, in a fixed order.
    pub(crate) fn rows(&self) -> impl Iterator<Item = &Lanes<T>> {
        self.x.iter().chain(&self.v).chain(&self.c).chain(&self.strain).chain(&self.q)
    }

    /// Copies one particle.
    pub(crate) fn copy_lane(&mut self, lane: usize, from: &Self, from_lane: usize) {
        fn copy<T: Copy, const N: usize>(
            to: &mut [Lanes<T>; N],
            lane: usize,
            from: &[Lanes<T>; N],
            at: usize,
        ) {
            for n in 0..N {
                to[n][lane] = from[n][at];
            }
        }
        copy(&mut self.x, lane, &from.x, from_lane);
        copy(&mut self.v, lane, &from.v, from_lane);
        copy(&mut self.c, lane, &from.c, from_lane);
        copy(&mut self.strain, lane, &from.strain, from_lane);
        copy(&mut self.q, lane, &from.q, from_lane);
    }

    #[inline(always)]
    pub(crate) fn strain_of(&self, l: usize) -> Sym3<T> {
        let s = &self.strain;
        [s[0][l], s[1][l], s[2][l], s[3][l], s[4][l], s[5][l]]
    }
}

#[inline(always)]
pub(crate) fn vec_of<T: Real>(a: &[Lanes<T>; 3], l: usize) -> Vec3<T> {
    [a[0][l], a[1][l], a[2][l]]
}

#[inline(always)]
pub(crate) fn set_vec<T: Real>(a: &mut [Lanes<T>; 3], l: usize, v: Vec3<T>) {
    a[0][l] = v[0];
    a[1][l] = v[1];
    a[2][l] = v[2];
}

#[inline(always)]
pub(crate) fn mat_of<T: Real>(a: &[Lanes<T>; 9], l: usize) -> Mat3<T> {
    [[a[0][l], a[1][l], a[2][l]], [a[3][l], a[4][l], a[5][l]], [a[6][l], a[7][l], a[8][l]]]
}

#[inline(always)]
pub(crate) fn set_mat<T: Real>(a: &mut [Lanes<T>; 9], l: usize, m: Mat3<T>) {
    for i in 0..3 {
        for j in 0..3 {
            a[3 * i + j][l] = m[i][j];
        }
    }
}

/// All particles, in the order of the grid's blocks; a group never spans two blocks.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Particles<T> {
    pub(crate) groups: Vec<Group<T>>,
    /// Identity of each particle (its place in the initial packing), or [`EMPTY_LANE`]; changed by sorting alone.
    pub(crate) ids: Arc<[[u32; LANES]]>,
}

impl<T: Real> Particles<T> {
    /// Particles at rest and free of stress at the given positions (m), identity = index.
    pub(crate) fn at_rest(positions: &[[f64; 3]]) -> Self {
        let (mut groups, mut ids) = (Vec::new(), Vec::new());
        for (index, p) in positions.iter().enumerate() {
            let lane = index % LANES;
            if lane == 0 {
                groups.push(Group::ZERO);
                ids.push([EMPTY_LANE; LANES]);
            }
            let last = groups.len() - 1;
            set_vec(&mut groups[last].x, lane, p.map(T::from_f64));
            ids[last][lane] = u32::try_from(index).expect("scenes are limited to fewer particles");
        }
        Self { groups, ids: ids.into() }
    }

    /// `(group, lane, identity)` of every particle, in memory order.
    pub(crate) fn occupied(&self) -> impl Iterator<Item = (usize, usize, u32)> {
        self.ids.iter().enumerate().flat_map(|(g, ids)| {
            ids.iter().enumerate().filter(|(_, id)| **id != EMPTY_LANE).map(move |(l, id)| (g, l, *id))
        })
    }

    /// Positions (m) in the order of identities.
    pub(crate) fn positions_by_id(&self) -> Vec<[f64; 3]> {
        self.by_id(|group| &group.x)
    }

    /// Velocities (m/s) in the order of identities.
    pub(crate) fn velocities_by_id(&self) -> Vec<[f64; 3]> {
        self.by_id(|group| &group.v)
    }

    fn by_id(&self, rows: impl Fn(&Group<T>) -> &[Lanes<T>; 3]) -> Vec<[f64; 3]> {
        let mut out = vec![[0.0; 3]; self.occupied().count()];
        for (g, l, id) in self.occupied() {
            out[id as usize] = vec_of(rows(&self.groups[g]), l).map(RealOps::to_f64);
        }
        out
    }
}
