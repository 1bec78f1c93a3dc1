//! Boxes about what is to be seen.

use powderline_shared::pose::Pose;

use crate::mesh::Mesh;

/// A box along the world's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Its lowest coordinates, metres.
    pub low_m: [f64; 3],
    /// Its highest, metres.
    pub high_m: [f64; 3],
}

impl Extent {
    /// All of a volume, `[0, size_m]`.
    #[must_use]
    pub fn of_volume(size_m: [f64; 3]) -> Self {
        Self { low_m: [0.0; 3], high_m: size_m }
    }

    /// The smallest one about points; none about no points. What is no number is left out.
    #[must_use]
    pub fn about(points_m: impl IntoIterator<Item = [f64; 3]>) -> Option<Self> {
        let finite = points_m.into_iter().filter(|point| point.iter().all(|part| part.is_finite()));
        finite.map(|point| Self { low_m: point, high_m: point }).reduce(|all, one| all.and(&one))
    }

    /// About a mesh wherever it goes; none if that is nowhere.
    #[must_use]
    pub fn swept(mesh: &Mesh, poses: &[Pose]) -> Option<Self> {
        let at = |pose: &Pose| {
            let world = |point: &[f64; 3]| pose.world_from_tool(&(*point).into()).into();
            Self::about(mesh.points_m.iter().map(world))
        };
        poses.iter().filter_map(at).reduce(|all, one| all.and(&one))
    }

    /// About both.
    #[must_use]
    pub fn and(&self, other: &Self) -> Self {
        Self {
            low_m: [0, 1, 2].map(|axis| self.low_m[axis].min(other.low_m[axis])),
            high_m: [0, 1, 2].map(|axis| self.high_m[axis].max(other.high_m[axis])),
        }
    }

    /// Its eight corners.
    #[must_use]
    pub fn corners(&self) -> [[f64; 3]; 8] {
        let pick = |index: usize, axis: usize| [self.low_m, self.high_m][index >> axis & 1][axis];
        std::array::from_fn(|index| [0, 1, 2].map(|axis| pick(index, axis)))
    }

    /// Its middle.
    #[must_use]
    pub fn middle_m(&self) -> [f64; 3] {
        [0, 1, 2].map(|axis| 0.5 * (self.low_m[axis] + self.high_m[axis]))
    }

    /// Its edges.
    #[must_use]
    pub fn size_m(&self) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.high_m[axis] - self.low_m[axis])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};

    #[test]
    fn a_mesh_is_held_wherever_it_goes() {
        let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let there = Pose { position_m: Vector3::new(1.0, 0.0, 0.5), orientation: quarter };
        let mesh = Mesh::block([0.0; 3], [0.3, 0.1, 0.2]);
        let swept = Extent::swept(&mesh, &[Pose::identity(), there]).unwrap();
        let near = |one: [f64; 3], other: [f64; 3]| (0..3).all(|i| (one[i] - other[i]).abs() < 1e-12);
        assert!(near(swept.low_m, [0.0; 3]) && near(swept.high_m, [1.0, 0.3, 0.7]), "{swept:?}");
        assert!(near(swept.middle_m(), [0.5, 0.15, 0.35]) && near(swept.size_m(), [1.0, 0.3, 0.7]));
        assert_eq!(Extent::about(swept.corners()), Some(swept));
    }

    #[test]
    fn nothing_has_no_extent() {
        assert_eq!(Extent::about([]), None);
        assert_eq!(Extent::about([[0.0, f64::NAN, 0.0]]), None);
        assert_eq!(Extent::swept(&Mesh::default(), &[Pose::identity()]), None);
    }
}
