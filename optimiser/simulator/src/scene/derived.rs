//! Quantities that follow from a scene's fields.

use powderline_shared::plan::SkillParameter;

use super::{
    Container, ContainerShape, FillShape, Objective, Powder, Quantity, Scene, SceneSpec, Skill, Time,
    YieldSurface,
};

/// Edge of a grid block, in cells.
pub const BLOCK_CELLS: usize = 4;

/// Most substeps of a rollout, settling included: days of computing for the smallest bench.
pub const MAX_SUBSTEPS: u64 = 100_000_000;

/// Blocks of padding at either end of each axis: a particle that leaves the domain by a cell still finds its nodes.
pub const PADDING_BLOCKS: usize = 2;

/// The largest grid that is accepted, in cells with the padding.
pub const MAX_CELLS: usize = 1 << 26;

/// The most particles that are accepted.
pub const MAX_PARTICLES: usize = 4_000_000;

/// The highest CFL number at which a scene is accepted.
pub const MAX_CFL: f64 = 0.5;

/// The largest [`SceneSpec::viscous_loss`] at which a scene is accepted.
pub const MAX_VISCOUS_LOSS: f64 = 0.5;

impl Time {
    /// Control period, seconds.
    pub fn control_period_s(&self) -> f64 {
        f64::from(self.control_period_us) * 1e-6
    }

    /// Length of an MPM substep, seconds.
    pub fn substep_s(&self) -> f64 {
        self.control_period_s() / f64::from(self.substeps)
    }

    /// Length of the whole motion, seconds.
    pub fn horizon_s(&self) -> f64 {
        self.control_period_s() * f64::from(self.horizon_steps)
    }

    /// Control steps of the settling phase: `settle_s` rounded up to whole control steps.
    pub fn settle_steps(&self) -> u32 {
        // The subtrahend keeps 0.2 s / 10 ms at 20 steps although the quotient may round to 20.000000000000004.
        (self.settle_s / self.control_period_s() - 1e-9).ceil().max(0.0) as u32
    }
}

impl Powder {
    /// First Lame parameter lambda = E nu / ((1 + nu) (1 - 2 nu)), pascal.
    pub fn lame_lambda_pa(&self) -> f64 {
        let (e, nu) = (self.youngs_modulus_pa, self.poissons_ratio);
        e * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    }

    /// Shear modulus mu = E / (2 (1 + nu)), pascal.
    pub fn lame_mu_pa(&self) -> f64 {
        self.youngs_modulus_pa / (2.0 * (1.0 + self.poissons_ratio))
    }

    /// Mean tension at the apex of the yield surface, pascal; 0 without cohesion.
    ///
    /// Of Drucker and Prager's cone `cohesion/tan(phi)`, as Mohr-Coulomb has it. Matsuoka and Nakai's is by
    /// so much lower as makes the unconfined strength in plane strain Mohr-Coulomb's,
    /// `2 cohesion tan(45 deg + phi/2)`: what a shear cell measures, and what a vertical cut stands by. Its
    /// angle there has the sine `2 s/sqrt(3 + s^2)`, `s = sin(phi)`.
    pub fn apex_tension_pa(&self) -> f64 {
        if self.cohesion_pa == 0.0 {
            return 0.0;
        }
        let phi = self.friction_angle_deg.to_radians();
        let tension_pa = self.cohesion_pa / libm::tan(phi);
        match self.yield_surface {
            YieldSurface::DruckerPrager => tension_pa,
            YieldSurface::MatsuokaNakai => {
                let s = libm::sin(phi);
                let plane = 2.0 * s / (3.0 + s * s).sqrt();
                // (1 + s)/(1 - s) - 1 of the one angle over that of the other.
                tension_pa * (s / (1.0 - s)) / (plane / (1.0 - plane))
            }
        }
    }

    /// P-wave modulus M = lambda + 2 mu, pascal.
    pub fn p_wave_modulus_pa(&self) -> f64 {
        self.lame_lambda_pa() + 2.0 * self.lame_mu_pa()
    }

    /// Speed of pressure waves, sqrt(M / density), m/s.
    pub fn sound_speed_m_s(&self) -> f64 {
        (self.p_wave_modulus_pa() / self.density_kg_m3).sqrt()
    }

    /// Extent of the fill box, metres.
    pub fn fill_size_m(&self) -> [f64; 3] {
        std::array::from_fn(|axis| self.fill_max_m[axis] - self.fill_min_m[axis])
    }

    /// Volume of what is filled with powder, cubic metres.
    pub fn fill_volume_m3(&self) -> f64 {
        let box_m3: f64 = self.fill_size_m().iter().product();
        match self.fill_shape {
            FillShape::Box => box_m3,
            FillShape::Cylinder => std::f64::consts::FRAC_PI_4 * box_m3,
        }
    }

    /// Middle of the fill box seen from above, metres.
    pub(super) fn fill_middle_m(&self) -> [f64; 2] {
        [0, 1].map(|axis| 0.5 * (self.fill_min_m[axis] + self.fill_max_m[axis]))
    }

    /// Radius of the column inscribed in the fill box, metres.
    pub(super) fn fill_radius_m(&self) -> f64 {
        let [length_m, width_m, _] = self.fill_size_m();
        0.5 * length_m.min(width_m)
    }
}

impl Container {
    /// A point of the world in the container's own frame, metres; the inner floor is at z = 0.
    pub(crate) fn local_m(&self, p: &[f64; 3]) -> [f64; 3] {
        let d = [0, 1, 2].map(|i| p[i] - self.position_m[i]);
        let (sin, cos) = libm::sincos(self.yaw_deg.to_radians());
        [cos * d[0] + sin * d[1], cos * d[1] - sin * d[0], d[2]]
    }

    /// Horizontal distance from a point to the container's opening, metres; 0 above it.
    pub(super) fn gap_to_opening_m(&self, p: [f64; 3]) -> f64 {
        let [x, y] = self.beside_m(&p);
        libm::hypot(x, y)
    }

    /// From the container's inside, as it is seen from above, to a point, metres, world frame; 0 within.
    pub(crate) fn beside_m(&self, p: &[f64; 3]) -> [f64; 2] {
        let nearest = self.nearest_from_above_m(p);
        [p[0] - nearest[0], p[1] - nearest[1]]
    }

    /// The point of the container's inner space that is nearest to another, metres, world frame.
    pub(crate) fn nearest_m(&self, p: &[f64; 3]) -> [f64; 3] {
        let [x, y, z] = self.local_m(p);
        if let ContainerShape::Hopper { .. } = self.shape {
            return self.nearest_in_hopper_m([x, y, z]);
        }
        let [x, y] = self.nearest_from_above_m(p);
        [x, y, self.position_m[2] + z.clamp(0.0, self.inner_height_m())]
    }

    /// The same of the inner space as it is seen from above.
    fn nearest_from_above_m(&self, p: &[f64; 3]) -> [f64; 2] {
        let [x, y, _] = self.local_m(p);
        let [x, y] = match self.shape {
            ContainerShape::Box { inner_size_m: [lx, ly, _] }
            | ContainerShape::SlottedBox { inner_size_m: [lx, ly, _], .. } => {
                [x.clamp(-0.5 * lx, 0.5 * lx), y.clamp(-0.5 * ly, 0.5 * ly)]
            }
            ContainerShape::Cylinder { inner_radius_m, .. }
            | ContainerShape::Silo { inner_radius_m, .. }
            | ContainerShape::Hopper { inner_radius_m, .. } => {
                let inwards = (inner_radius_m / libm::hypot(x, y)).min(1.0);
                [x * inwards, y * inwards]
            }
        };
        let (sin, cos) = libm::sincos(self.yaw_deg.to_radians());
        let [origin_x, origin_y, _] = self.position_m;
        [origin_x + cos * x - sin * y, origin_y + sin * x + cos * y]
    }

    /// The same of a hopper, from a point in its own frame: its profile is a convex polygon.
    fn nearest_in_hopper_m(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let (rho, top) = (libm::hypot(x, y), self.inner_height_m());
        let radius = |height: f64| self.shape.inner_radius_at_m(height).unwrap_or_default();
        let is_inside = (0.0..=top).contains(&z) && rho <= radius(z);
        let [near_rho, near_z] = if is_inside {
            [rho, z]
        } else {
            let cone = self.shape.cone_height_m().min(top);
            let corners =
                [[0.0, 0.0], [radius(0.0), 0.0], [radius(cone), cone], [radius(top), top], [0.0, top]];
            let sides = corners.windows(2).map(|ends| nearest_between([rho, z], ends[0], ends[1]));
            let away = |p: &[f64; 2]| libm::hypot(p[0] - rho, p[1] - z);
            sides.min_by(|a, b| away(a).total_cmp(&away(b))).unwrap_or([rho, z])
        };
        let inwards = if rho > 0.0 { near_rho / rho } else { 0.0 };
        let (sin, cos) = libm::sincos(self.yaw_deg.to_radians());
        let [origin_x, origin_y, origin_z] = self.position_m;
        let (x, y) = (x * inwards, y * inwards);
        [origin_x + cos * x - sin * y, origin_y + sin * x + cos * y, origin_z + near_z]
    }
}

/// The point between two others that is nearest to a third.
fn nearest_between(p: [f64; 2], a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    let along = [b[0] - a[0], b[1] - a[1]];
    let length = along[0] * along[0] + along[1] * along[1];
    let share = ((p[0] - a[0]) * along[0] + (p[1] - a[1]) * along[1]) / length.max(f64::MIN_POSITIVE);
    [0, 1].map(|axis| a[axis] + share.clamp(0.0, 1.0) * along[axis])
}

impl Skill {
    /// Range of a parameter, in the unit of its key.
    pub fn range(&self, parameter: SkillParameter) -> [f64; 2] {
        match parameter {
            SkillParameter::ScoopingDepth => self.scooping_depth_m,
            SkillParameter::ScoopingAngle => self.scooping_angle_deg,
            SkillParameter::LiftHeight => self.lift_height_m,
            SkillParameter::TransportDisplacement => self.transport_displacement_m,
            SkillParameter::PouringAngle => self.pouring_angle_deg,
        }
    }
}

impl Scene {
    /// The same with powder that never sleeps.
    #[must_use]
    pub fn without_sleep(&self) -> Self {
        let mut scene = self.clone();
        scene.0.domain.sleep_speed_m_s = 0.0;
        scene
    }
}

impl SceneSpec {
    /// The point of the source container that is nearest to the target point, metres; the target point itself in a scene that
    /// was made up for measurements and has no source.
    pub(crate) fn nearest_of_source_m(&self) -> [f64; 3] {
        let Objective { source, p_target_m, .. } = &self.objective;
        let source = self.containers.iter().find(|container| container.name == *source);
        source.map_or(*p_target_m, |source| source.nearest_m(p_target_m))
    }

    /// How far the point of the source container that is nearest to the target point is from that, metres, in the objective's norm: about
    /// what a particle costs that is missing, or one too many ([`Aim::Amount`](super::Aim::Amount)).
    pub fn source_distance_m(&self) -> f64 {
        let (from, to) = (self.nearest_of_source_m(), self.objective.p_target_m);
        self.objective.norm.length(&[0, 1, 2].map(|axis| from[axis] - to[axis]))
    }

    /// Volume of one particle at rest, cell^3 / particles_per_cell, m^3.
    pub fn particle_volume_m3(&self) -> f64 {
        self.domain.cell_m.powi(3) / f64::from(self.powder.particles_per_cell)
    }

    /// Part of the strain rate's momentum that viscosity takes in one substep, `8 eta dt / (rho cell^2)`,
    /// dimensionless; at most [`MAX_VISCOUS_LOSS`].
    pub fn viscous_loss(&self) -> f64 {
        8.0 * self.powder.viscosity_pa_s * self.time.substep_s()
            / (self.powder.density_kg_m3 * self.domain.cell_m.powi(2))
    }

    /// Mass of one particle, kilogram.
    pub fn particle_mass_kg(&self) -> f64 {
        self.particle_volume_m3() * self.powder.density_kg_m3
    }

    /// Cells along x, y, z that cover the domain, without padding.
    pub fn cell_counts(&self) -> [usize; 3] {
        // 0.256 / 0.004 may round to just above 64; a millionth of a cell is no reason for another layer.
        self.domain.size_m.map(|size_m| (size_m / self.domain.cell_m - 1e-6).ceil() as usize)
    }

    /// Blocks of 4 x 4 x 4 cells along x, y, z, with the padding of [`PADDING_BLOCKS`] at either end.
    pub fn block_counts(&self) -> [usize; 3] {
        self.cell_counts().map(|cells| cells.div_ceil(BLOCK_CELLS) + 2 * PADDING_BLOCKS)
    }

    /// Courant number sqrt(P-wave modulus / density) dt_sub / cell, dimensionless; at most [`MAX_CFL`].
    pub fn cfl_number(&self) -> f64 {
        self.powder.sound_speed_m_s() * self.time.substep_s() / self.domain.cell_m
    }

    /// Particles wanted in the target container; a mass is rounded to whole particles, at least one.
    pub fn target_count(&self) -> usize {
        match self.objective.amount.wanted {
            Quantity::Particles(count) => count as usize,
            Quantity::MassKg(mass_kg) => ((mass_kg / self.particle_mass_kg()).round() as usize).max(1),
        }
    }

    /// Mass wanted in the target container, kilogram.
    pub fn target_mass_kg(&self) -> f64 {
        match self.objective.amount.wanted {
            Quantity::Particles(count) => f64::from(count) * self.particle_mass_kg(),
            Quantity::MassKg(mass_kg) => mass_kg,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn container(shape: ContainerShape) -> Container {
        Container {
            name: "source".into(),
            position_m: [1.0, 2.0, 0.5],
            yaw_deg: 90.0,
            wall_thickness_m: 0.1,
            friction: 0.4,
            shape,
        }
    }

    fn assert_near(found: [f64; 3], wanted: [f64; 3]) {
        assert!((0..3).all(|i| (found[i] - wanted[i]).abs() < 1e-12), "{found:?} {wanted:?}");
    }

    #[test]
    fn nearest_point_of_a_turned_box() {
        let container = container(ContainerShape::Box { inner_size_m: [0.4, 0.2, 0.3] });
        // Its length lies along y now.
        assert_near(container.nearest_m(&[3.0, 2.05, 0.0]), [1.1, 2.05, 0.5]);
        assert_near(container.nearest_m(&[1.0, 5.0, 9.0]), [1.0, 2.2, 0.8]);
        assert_near(container.nearest_m(&[1.05, 2.1, 0.6]), [1.05, 2.1, 0.6]);
    }

    #[test]
    fn nearest_point_of_a_cylinder() {
        let container = container(ContainerShape::Cylinder { inner_radius_m: 0.5, inner_height_m: 0.3 });
        assert_near(container.nearest_m(&[4.0, 6.0, 0.6]), [1.3, 2.4, 0.6]);
        assert_near(container.nearest_m(&[1.0, 2.0, 0.6]), [1.0, 2.0, 0.6]);
    }

    #[test]
    fn nearest_point_of_a_hopper() {
        let (inner_radius_m, inner_height_m, outlet_radius_m, half_angle_deg) = (0.5, 0.6, 0.1, 45.0);
        let shape =
            ContainerShape::Hopper { inner_radius_m, inner_height_m, outlet_radius_m, half_angle_deg };
        let container = container(shape);
        assert!((container.shape.cone_height_m() - 0.4).abs() < 1e-12);
        // In it, below its hole, beside its cone (straight across), beside its cylinder, above its rim.
        assert_near(container.nearest_m(&[1.2, 2.0, 0.65]), [1.2, 2.0, 0.65]);
        assert_near(container.nearest_m(&[1.05, 2.0, 0.2]), [1.05, 2.0, 0.5]);
        assert_near(container.nearest_m(&[1.0, 2.4, 0.6]), [1.0, 2.3, 0.7]);
        assert_near(container.nearest_m(&[4.0, 6.0, 1.0]), [1.3, 2.4, 1.0]);
        assert_near(container.nearest_m(&[1.3, 2.0, 2.0]), [1.3, 2.0, 1.1]);
        // From above the inside is as wide as its rim.
        assert_near([container.gap_to_opening_m([1.4, 2.0, 0.55]), 0.0, 0.0], [0.0; 3]);
        assert_near([container.gap_to_opening_m([1.0, 2.7, 0.55]), 0.0, 0.0], [0.2, 0.0, 0.0]);
        // A funnel has no cylinder.
        let shape =
            ContainerShape::Hopper { inner_radius_m, inner_height_m: 0.4, outlet_radius_m, half_angle_deg };
        let funnel = Container { shape, ..container };
        assert_near(funnel.nearest_m(&[4.0, 6.0, 1.0]), [1.3, 2.4, 0.9]);
    }
}
