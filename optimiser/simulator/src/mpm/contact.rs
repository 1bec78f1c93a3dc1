//! Contact of powder with a rigid body: Coulomb friction, blended over a narrow band.
//!
//! | symbol | identifier | meaning |
//! |---|---|---|
//! | `s`, `n` | `s`, `n` | signed distance and outward normal of the body at the point |
//! | `v_b` | `vb` | velocity of the body at the point |
//! | `beta` | `beta` | blend: 1 inside, falling to 0 at the band's end |
//! | `r` | `separation_factor` | part of a separating velocity that is left: 1, or 0 at nodes that both sides of a wall share |
//! | `mu_f` | `friction` | Coulomb coefficient |
//!
//! `v_r = v - v_b`, `v_n = v_r.n`, `v_t = v_r - v_n n`. The normal part becomes `a = r max(v_n, push)`,
//! friction takes `mu_f |a - v_n|` from the tangential part, and the result is blended with the free velocity.
//!
//! Two choices differ from the usual `min(exp(-k s), 1)` on velocities that approach. The blend is a cubic with
//! compact support: it has a derivative everywhere, also at the surface, and it is exactly 0 beyond the band, so
//! that leaving out bodies that are farther away changes no bit. And a node that both sides of a wall share moves with it along
//! its normal (`r = 0`), whatever the powder wants there: it sees powder on both sides and cannot tell which of
//! them pushes, so that a node near the far face would take powder pressed on the near one for powder that leaves,
//! and hand its pressure on. What this costs is that powder lets go of a wall more slowly than it should. Where either side has
//! nodes of its own ([`super::walls`]) all let go (`r = 1`).

use crate::real::Real;
use crate::shape::{Dual, SignedDistance};
use crate::small::{Mat3, Vec3, add, cross, dot, mul_vec, scale, sub, three, tr_mul_vec};

/// A rigid body at one instant. `rotation` and `position` map its frame to the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BodyState<T> {
    pub(crate) rotation: Mat3<T>,
    pub(crate) position: Vec3<T>,
    pub(crate) velocity: Vec3<T>,
    pub(crate) angular_velocity: Vec3<T>,
}

/// The law of contact with one body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ContactParams<T> {
    pub(crate) friction: T,
    /// Where the blend has fallen to zero, m beyond the surface.
    pub(crate) band: T,
    /// How far the surface is moved outwards, m.
    pub(crate) inflation: T,
    /// Part of a separating velocity that is left.
    pub(crate) separation_factor: T,
    /// Speed of the outward push per metre of depth, 1/s; zero at grid nodes.
    pub(crate) pushout_rate: T,
    /// Upper bound of that push, m/s.
    pub(crate) max_pushout_speed: T,
}

impl<T: Real> ContactParams<T> {
    /// Distance from the body beyond which nothing changes, m.
    #[inline(always)]
    pub(crate) fn reach(&self) -> T {
        self.inflation + self.band
    }
}

/// Tangential speeds below this feel a friction that fades to zero, m/s: rest has no direction.
const REST_SPEED: f64 = 1e-4;

/// Cotangent of a body's motion, summed over all that touches it: of the position, of a left (world-frame)
/// rotation of the body, of its velocity and of its angular velocity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct BodyStateBar {
    pub(crate) position: [f64; 3],
    pub(crate) rotation: [f64; 3],
    pub(crate) velocity: [f64; 3],
    pub(crate) angular_velocity: [f64; 3],
}

impl BodyStateBar {
    pub(crate) fn add(&mut self, other: &Self) {
        for i in 0..3 {
            self.position[i] += other.position[i];
            self.rotation[i] += other.rotation[i];
            self.velocity[i] += other.velocity[i];
            self.angular_velocity[i] += other.angular_velocity[i];
        }
    }
}

/// Smooth step `3 t^2 - 2 t^3` on [0, 1] and its derivative.
#[inline(always)]
fn smooth_step<T: Real>(t: T) -> (T, T) {
    let t = t.unit();
    (t * t * (T::from_f64(3.0) - t - t), T::from_f64(6.0) * t * (T::ONE - t))
}

/// Velocity after contact.
#[inline(always)]
pub(crate) fn contact<T: Real, D: SignedDistance<T>>(
    shape: &D,
    body: &BodyState<T>,
    law: &ContactParams<T>,
    x: Vec3<T>,
    v: Vec3<T>,
) -> Vec3<T> {
    let arm = sub(x, body.position);
    let (s, normal) = shape.distance(tr_mul_vec(&body.rotation, arm));
    let n = mul_vec(&body.rotation, normal);
    let vb = add(body.velocity, cross(body.angular_velocity, arm));
    let f = resolve(law, s - law.inflation, n, sub(v, vb));
    add(v, scale(f.beta, sub(add(vb, f.relative), v)))
}

/// Relative velocity after contact, with what the adjoint needs of the way there.
struct Resolved<T> {
    beta: T,
    beta_slope: T,
    push: T,
    push_slope: T,
    vn: T,
    vt: Vec3<T>,
    /// Smoothed tangential speed.
    speed: T,
    /// Normal velocity after contact.
    a: T,
    keep: T,
    relative: Vec3<T>,
}

#[inline(always)]
fn resolve<T: Real>(law: &ContactParams<T>, s: T, n: Vec3<T>, vr: Vec3<T>) -> Resolved<T> {
    let inverse_band = T::ONE / law.band;
    let (fall, fall_slope) = smooth_step(s * inverse_band);
    let raw_push = -(s * law.pushout_rate);
    let push = raw_push.at_least(T::ZERO).at_most(law.max_pushout_speed);
    let pushing = raw_push > T::ZERO && raw_push < law.max_pushout_speed;
    let vn = dot(vr, n);
    let vt = sub(vr, scale(vn, n));
    let speed = (dot(vt, vt) + T::from_f64(REST_SPEED * REST_SPEED)).sqrt();
    let a = law.separation_factor * vn.at_least(push);
    let keep = (T::ONE - law.friction * (a - vn).abs() / speed).at_least(T::ZERO);
    Resolved {
        beta: T::ONE - fall,
        beta_slope: -(fall_slope * inverse_band),
        push,
        push_slope: (-law.pushout_rate).only_if(pushing),
        vn,
        vt,
        speed,
        a,
        keep,
        relative: add(scale(a, n), scale(keep, vt)),
    }
}

/// Cotangents of [`contact`] for one point.
pub(crate) struct ContactBar<T> {
    pub(crate) x: Vec3<T>,
    pub(crate) v: Vec3<T>,
    pub(crate) rotation: Vec3<T>,
    pub(crate) velocity: Vec3<T>,
    pub(crate) angular_velocity: Vec3<T>,
}

/// Adjoint of [`contact`]. The cotangent of the body's position is `-x`.
#[inline(always)]
pub(crate) fn contact_adjoint<T: Real, D: SignedDistance<T>>(
    shape: &D,
    body: &BodyState<T>,
    law: &ContactParams<T>,
    x: Vec3<T>,
    v: Vec3<T>,
    bar: Vec3<T>,
) -> ContactBar<T> {
    let arm = sub(x, body.position);
    let y = tr_mul_vec(&body.rotation, arm);
    let (s, normal) = shape.distance(y);
    let n = mul_vec(&body.rotation, normal);
    let vb = add(body.velocity, cross(body.angular_velocity, arm));
    let f = resolve(law, s - law.inflation, n, sub(v, vb));

    // v_out = v + beta (v_b + a n + keep v_t - v)
    let result_bar = scale(f.beta, bar);
    let beta_bar = dot(bar, sub(add(vb, f.relative), v));
    let mut a_bar = dot(result_bar, n);
    let mut n_bar = scale(f.a, result_bar);
    let keep_bar = dot(result_bar, f.vt).only_if(f.keep > T::ZERO);
    let mut vt_bar = scale(f.keep, result_bar);

    // keep = 1 - friction |a - v_n| / speed
    let per_speed = law.friction / f.speed;
    let removed = f.a - f.vn;
    let removed_bar = if removed < T::ZERO { per_speed * keep_bar } else { -(per_speed * keep_bar) };
    let speed_bar = per_speed * removed.abs() * keep_bar / f.speed;
    vt_bar = add(vt_bar, scale(speed_bar / f.speed, f.vt));
    a_bar += removed_bar;
    let mut vn_bar = -removed_bar;

    // a = separation_factor max(v_n, push)
    let free = f.vn >= f.push;
    vn_bar += (law.separation_factor * a_bar).only_if(free);
    let push_bar = (law.separation_factor * a_bar).only_if(!free);

    // v_t = v_r - v_n n, v_n = v_r . n
    let mut vr_bar = vt_bar;
    vn_bar -= dot(vt_bar, n);
    n_bar = sub(n_bar, scale(f.vn, vt_bar));
    vr_bar = add(vr_bar, scale(vn_bar, n));
    n_bar = add(n_bar, scale(vn_bar, add(f.vt, scale(f.vn, n))));

    let v_bar = add(scale(T::ONE - f.beta, bar), vr_bar);
    let vb_bar = sub(result_bar, vr_bar);
    let s_bar = f.beta_slope * beta_bar + f.push_slope * push_bar;

    // s and n in the body's frame; Hessian of the distance times n_bar by dual numbers.
    let local_n_bar = tr_mul_vec(&body.rotation, n_bar);
    let (_, turned) = shape.distance(three!(i => Dual { value: y[i], partial: local_n_bar[i] }));
    let y_bar = three!(i => s_bar * normal[i] + turned[i].partial);
    let g = mul_vec(&body.rotation, y_bar);

    ContactBar {
        x: add(g, cross(vb_bar, body.angular_velocity)),
        v: v_bar,
        rotation: add(cross(g, arm), cross(n, n_bar)),
        velocity: vb_bar,
        angular_velocity: cross(arm, vb_bar),
    }
}
