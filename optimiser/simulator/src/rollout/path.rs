//! The tool's motion: from a control sequence to a pose and twist in every substep, and back.
//!
//! Within control step `i` the tool moves at constant linear and angular velocity (`u_sub = u / N_sub`):
//! at the end of its substep `j`, with `a = (j + 1)/N_sub`, position `p_i + a dp_i`, orientation
//! `exp(a dr_i) R_i`, velocity `dp_i/dt`, angular velocity `dr_i/dt`. Gates go by the substeps of the whole motion, of which a
//! path may be a later stretch.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use powderline_shared::displacement::Displacement;
use powderline_shared::pose::{Pose, exp_so3};

use crate::mpm::bodies::{Bodies, Gates, Moment};
use crate::mpm::contact::{BodyState, BodyStateBar};
use crate::real::Real;
use crate::skill::Control;

/// Cotangent of a pose: of its position, and of its rotation from the left.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct PoseBar {
    pub(crate) position: Vector3<f64>,
    pub(crate) rotation: Vector3<f64>,
}

impl PoseBar {
    /// Adds that of a point, `arm` away from the pose's position, that moves with it.
    pub(crate) fn push(&mut self, arm: &Vector3<f64>, force: &Vector3<f64>) {
        self.position += force;
        self.rotation += arm.cross(force);
    }

    /// Position before rotation.
    pub(crate) fn components(&self) -> [f64; 6] {
        let (p, r) = (self.position, self.rotation);
        [p.x, p.y, p.z, r.x, r.y, r.z]
    }
}

/// A control sequence from an anchor pose.
pub(crate) struct Trajectory {
    /// Substeps of the motion that are done where it begins.
    begins_after: usize,
    /// Pose at the beginning of each control step.
    poses: Vec<Pose>,
    controls: Vec<Displacement>,
    substeps: u32,
    period_s: f64,
}

impl Trajectory {
    pub(crate) fn new(
        begins_after: usize,
        anchor: Pose,
        controls: Vec<Displacement>,
        substeps: u32,
        period_s: f64,
    ) -> Self {
        let mut pose = anchor;
        let poses = controls
            .iter()
            .map(|u| {
                let before = pose;
                pose = pose.displaced(u);
                before
            })
            .collect();
        Self { begins_after, poses, controls, substeps, period_s }
    }

    /// Substeps in the whole path.
    pub(crate) fn len(&self) -> usize {
        self.controls.len() * self.substeps as usize
    }

    /// Control steps in the whole path.
    pub(crate) fn steps(&self) -> usize {
        self.controls.len()
    }

    /// Substeps of a control step.
    pub(crate) fn substeps_of(&self, step: usize) -> core::ops::Range<usize> {
        let n = self.substeps as usize;
        step * n..(step + 1) * n
    }

    /// The bits of a control.
    pub(crate) fn control_bits(&self, step: usize) -> [u64; 6] {
        self.controls[step].components().map(f64::to_bits)
    }

    /// Pose at the beginning of a control step, or after the last one.
    pub(crate) fn pose_before(&self, step: usize) -> Pose {
        self.poses
            .get(step)
            .copied()
            .unwrap_or_else(|| self.poses[step - 1].displaced(&self.controls[step - 1]))
    }

    /// The first control step that leads to where no numbers are.
    pub(crate) fn first_not_finite(&self) -> Option<usize> {
        let is_finite = |pose: Pose| {
            pose.position_m.iter().all(|x| x.is_finite())
                && pose.orientation.coords.iter().all(|x| x.is_finite())
        };
        (0..self.steps()).find(|step| !is_finite(self.pose_before(step + 1)))
    }

    /// Pose after the last step.
    pub(crate) fn end(&self) -> Option<Pose> {
        Some(self.poses.last()?.displaced(self.controls.last()?))
    }

    fn place(&self, substep: usize) -> (usize, f64) {
        let n = self.substeps as usize;
        (substep / n, (substep % n + 1) as f64 / n as f64)
    }

    /// Substeps of the motion that are done where it ends.
    pub(crate) fn ends_after(&self) -> usize {
        self.begins_after + self.len()
    }

    /// The tool and the gates in the given substep (counted from the start of the path).
    pub(crate) fn bodies<T: Real>(&self, gates: &Gates, substep: usize) -> Bodies<T> {
        let moment = Moment::After(self.begins_after + substep);
        Bodies { tool: self.motion(substep), gates: gates.at(moment) }
    }

    /// Motion at the end of the given substep (counted from the start of the path).
    pub(crate) fn motion<T: Real>(&self, substep: usize) -> BodyState<T> {
        let (step, part) = self.place(substep);
        let u = &self.controls[step];
        let turn = exp_so3(&(u.rotation() * part));
        let pose = &self.poses[step];
        let position = pose.position_m + u.translation() * part;
        motion(
            &position,
            &(turn * pose.orientation),
            &(u.translation() / self.period_s),
            &(u.rotation() / self.period_s),
        )
    }

    /// Begins the way back.
    pub(crate) fn pull_back(&self) -> TrajectoryAdjoint<'_> {
        TrajectoryAdjoint {
            path: self,
            bars: Vec::with_capacity(self.substeps as usize),
            position_bar: Vector3::zeros(),
            rotation_bar: Vector3::zeros(),
            out: vec![[0.0; 6]; self.controls.len()],
        }
    }
}

/// Cotangents of the controls from those of the motion in every substep, which come from the last to the first.
pub(crate) struct TrajectoryAdjoint<'a> {
    path: &'a Trajectory,
    /// Those of one control step, so that a long motion with many substeps needs no memory for them.
    bars: Vec<BodyStateBar>,
    /// Cotangent of the pose at the end of the step at hand: position, and rotation from the left.
    position_bar: Vector3<f64>,
    rotation_bar: Vector3<f64>,
    out: Vec<Control>,
}

impl TrajectoryAdjoint<'_> {
    /// Takes the cotangent of the motion in the substep before the one taken last.
    pub(crate) fn take(&mut self, substep: usize, bar: BodyStateBar) {
        self.bars.push(bar);
        let (step, _) = self.path.place(substep);
        if substep.is_multiple_of(self.path.substeps as usize) {
            self.finish(step);
        }
    }

    /// Cotangent of the pose at the beginning of the control step whose substeps have been taken last.
    pub(crate) fn pose_bar(&self) -> PoseBar {
        PoseBar { position: self.position_bar, rotation: self.rotation_bar }
    }

    /// Goes on with another one.
    pub(crate) fn go_on_with(&mut self, bar: &PoseBar) {
        (self.position_bar, self.rotation_bar) = (bar.position, bar.rotation);
    }

    fn finish(&mut self, step: usize) {
        let Trajectory { controls, substeps, period_s, .. } = self.path;
        let dr = controls[step].rotation();
        let mut dp_bar: Vector3<f64> = self.position_bar;
        let mut dr_bar = left_jacobian(&dr).tr_mul(&self.rotation_bar);
        self.rotation_bar = exp_so3(&dr).inverse() * self.rotation_bar;
        for (substep, bar) in (step * *substeps as usize..).zip(self.bars.drain(..).rev()) {
            let (_, part) = self.path.place(substep);
            let partial = dr * part;
            let turned = Vector3::from(bar.rotation);
            dp_bar += Vector3::from(bar.position) * part + Vector3::from(bar.velocity) / *period_s;
            dr_bar += left_jacobian(&partial).tr_mul(&turned) * part
                + Vector3::from(bar.angular_velocity) / *period_s;
            self.position_bar += Vector3::from(bar.position);
            self.rotation_bar += exp_so3(&partial).inverse() * turned;
        }
        self.out[step] = [dp_bar.x, dp_bar.y, dp_bar.z, dr_bar.x, dr_bar.y, dr_bar.z];
    }

    /// Cotangents of the controls, once all substeps have been taken.
    pub(crate) fn finished(self) -> Vec<Control> {
        self.out
    }
}

/// The tool standing still.
pub(crate) fn resting<T: Real>(pose: &Pose) -> BodyState<T> {
    motion(&pose.position_m, &pose.orientation, &Vector3::zeros(), &Vector3::zeros())
}

fn motion<T: Real>(
    p: &Vector3<f64>,
    r: &UnitQuaternion<f64>,
    v: &Vector3<f64>,
    w: &Vector3<f64>,
) -> BodyState<T> {
    let m: Matrix3<f64> = r.to_rotation_matrix().into_inner();
    let vector = |a: &Vector3<f64>| [T::from_f64(a.x), T::from_f64(a.y), T::from_f64(a.z)];
    BodyState {
        rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| T::from_f64(m[(i, j)]))),
        position: vector(p),
        velocity: vector(v),
        angular_velocity: vector(w),
    }
}

/// Left Jacobian of SO(3): `exp(r + d) ~ exp(J d) exp(r)` (Sola et al. 2018, equation 145).
fn left_jacobian(r: &Vector3<f64>) -> Matrix3<f64> {
    let angle2 = r.norm_squared();
    let cross = r.cross_matrix();
    let (a, b) = if angle2 < 1e-8 {
        (0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0)
    } else {
        let angle = angle2.sqrt();
        ((1.0 - libm::cos(angle)) / angle2, (angle - libm::sin(angle)) / (angle2 * angle))
    };
    Matrix3::identity() + cross * a + cross * cross * b
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A made-up linear functional of all motions; its gradient must be what `pull_back` says.
    #[test]
    fn pull_back_is_the_derivative_of_the_path() {
        let anchor = Pose {
            position_m: Vector3::new(0.1, 0.2, 0.3),
            orientation: exp_so3(&Vector3::new(0.3, -0.2, 0.5)),
        };
        let wave = |k: usize, f: f64| (k as f64 * f).sin();
        let controls: Vec<Control> =
            (0..4).map(|i| [0, 1, 2, 3, 4, 5].map(|c| 0.2 * wave(6 * i + c + 1, 1.7))).collect();
        let functional = |controls: &[Control]| {
            let path = Trajectory::new(
                0,
                anchor,
                controls.iter().copied().map(Displacement::from).collect(),
                3,
                0.01,
            );
            let mut sum = 0.0;
            for s in 0..path.len() {
                let m: BodyState<f64> = path.motion(s);
                for i in 0..3 {
                    sum += wave(s + i, 0.9) * m.position[i] + 1e-3 * wave(s + i, 2.1) * m.velocity[i];
                    sum += 1e-3 * wave(s + i, 3.3) * m.angular_velocity[i];
                    for j in 0..3 {
                        sum += wave(s + 3 * i + j, 0.7) * m.rotation[i][j];
                    }
                }
            }
            sum
        };
        let path =
            Trajectory::new(0, anchor, controls.iter().copied().map(Displacement::from).collect(), 3, 0.01);
        let bars: Vec<BodyStateBar> = (0..path.len())
            .map(|s| {
                let m: BodyState<f64> = path.motion(s);
                let mut bar = BodyStateBar::default();
                for i in 0..3 {
                    bar.position[i] = wave(s + i, 0.9);
                    bar.velocity[i] = 1e-3 * wave(s + i, 2.1);
                    bar.angular_velocity[i] = 1e-3 * wave(s + i, 3.3);
                }
                // d(R) = [phi]x R: column by column phi x r_j.
                for j in 0..3 {
                    let column = [0, 1, 2].map(|i| m.rotation[i][j]);
                    let weight = [0, 1, 2].map(|i| wave(s + 3 * i + j, 0.7));
                    let turned = crate::small::cross(column, weight);
                    for (sum, t) in bar.rotation.iter_mut().zip(turned) {
                        *sum += t;
                    }
                }
                bar
            })
            .collect();
        let mut back = path.pull_back();
        for (substep, bar) in bars.into_iter().enumerate().rev() {
            back.take(substep, bar);
        }
        let gradient = back.finished();
        for i in 0..controls.len() {
            for c in 0..6 {
                let at = |h: f64| {
                    let mut moved = controls.clone();
                    moved[i][c] += h;
                    functional(&moved)
                };
                let slope = (at(1e-5) - at(-1e-5)) / 2e-5;
                assert!(
                    (slope - gradient[i][c]).abs() < 1e-7 * (1.0 + slope.abs()),
                    "{i} {c}: {slope} {}",
                    gradient[i][c]
                );
            }
        }
    }
}
