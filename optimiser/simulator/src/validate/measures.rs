//! What is read off a deposit: run-out, height, slope, packing. Nothing here knows where the particles come
//! from.

/// Value below which a share of the numbers lies, linear between neighbours; NaN of none.
pub(super) fn quantile(numbers: &[f64], share: f64) -> f64 {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let place = share * last as f64;
    let low = (place as usize).min(last);
    let high = (low + 1).min(last);
    sorted[low] + (place - low as f64) * (sorted[high] - sorted[low])
}

/// Straight line by least squares: value at 0, and slope; NaN where there is none.
pub(super) fn line(points: &[[f64; 2]]) -> [f64; 2] {
    let n = points.len() as f64;
    let mean = [0, 1].map(|i| points.iter().map(|p| p[i]).sum::<f64>() / n);
    let sum = |i: usize| points.iter().map(|p| (p[0] - mean[0]) * (p[i] - mean[i])).sum::<f64>();
    let slope = sum(1) / sum(0);
    [mean[1] - slope * mean[0], slope]
}

/// Powder on a plate, round about an axis.
pub(super) struct Deposit {
    /// Particles: along the plate from the axis, and above the plate, m.
    points: Vec<[f64; 3]>,
    /// Volume of one particle, m^3.
    volume_m3: f64,
    /// Distance of neighbours at rest: edge of a particle's own cube, m.
    spacing_m: f64,
}

impl Deposit {
    /// Of particles in the world, with the axis at `x` and `y` on the floor.
    pub(super) fn new(particles: &[[f64; 3]], axis: [f64; 2], volume_m3: f64) -> Self {
        let points = particles.iter().map(|p| [p[0] - axis[0], p[1] - axis[1], p[2]]).collect();
        Self { points, volume_m3, spacing_m: libm::cbrt(volume_m3) }
    }

    fn radius(point: &[f64; 3]) -> f64 {
        libm::hypot(point[0], point[1])
    }

    /// Radius that holds a share of the particles, m.
    pub(super) fn radius_of(&self, share: f64) -> f64 {
        quantile(&self.points.iter().map(Self::radius).collect::<Vec<_>>(), share)
    }

    /// Outermost radius at which the powder, at its own density, is one spacing thick, m; 0 if it is nowhere.
    ///
    /// Thickness is counted in rings one spacing wide and averaged over three of them.
    pub(super) fn front(&self) -> f64 {
        let s = self.spacing_m;
        let ring = |point: &[f64; 3]| (Self::radius(point) / s) as usize;
        let rings = self.points.iter().map(ring).max().unwrap_or(0) + 3;
        let mut volume = vec![0.0; rings];
        self.points.iter().for_each(|point| volume[ring(point)] += self.volume_m3);
        // The area of a ring, and of three.
        let area = |k: usize| core::f64::consts::PI * s * s * (2 * k + 1) as f64;
        let thickness = |k: usize| {
            let around = k.saturating_sub(1)..(k + 2).min(rings);
            volume[around.clone()].iter().sum::<f64>() / around.map(area).sum::<f64>()
        };
        let Some(last) = (0..rings - 1).rev().find(|k| thickness(*k) >= s) else { return 0.0 };
        let (inner, outer) = (thickness(last), thickness(last + 1));
        s * (last as f64 + 0.5 + (inner - s) / (inner - outer))
    }

    /// The surface: of each square column two spacings wide its highest particle, as radius and height, m.
    ///
    /// That particle lies a quarter of a spacing below the surface on average, whether particles lie in
    /// layers (a fifth) or anyhow (a quarter), which is added. It stands for the place where it is, not for
    /// the column's middle: the highest of a sloping column lies on its upper side.
    pub(super) fn surface(&self) -> Vec<[f64; 2]> {
        let width = 2.0 * self.spacing_m;
        let column = |p: &[f64; 3]| [0, 1].map(|axis| (p[axis] / width).floor() as i64);
        let mut points: Vec<_> = self.points.iter().collect();
        points.sort_by(|a, b| column(a).cmp(&column(b)).then(b[2].total_cmp(&a[2])));
        let highest = points.chunk_by(|a, b| column(a) == column(b)).map(|column| column[0]);
        highest.map(|p| [Self::radius(p), p[2] + 0.25 * self.spacing_m]).collect()
    }

    /// Height of the surface at the axis, by a straight line through what lies nearer to it than `within`, m.
    pub(super) fn apex(&self, within: f64) -> f64 {
        let near: Vec<_> = self.surface().into_iter().filter(|p| p[0] < within).collect();
        line(&near)[0]
    }

    /// Slope of the surface between 80 and 20 % of the height, rad; 0 where there is none.
    ///
    /// The two radii are those of the mean surface in rings one spacing wide, so that no single column is
    /// chosen by its own height.
    pub(super) fn slope(&self) -> f64 {
        let surface = self.surface();
        let ring = |p: &[f64; 2]| (p[0] / self.spacing_m) as usize;
        let rings = surface.iter().map(ring).max().map_or(0, |last| last + 1);
        let mean = |k: usize| {
            let of: Vec<_> = surface.iter().filter(|p| ring(p) == k).map(|p| p[1]).collect();
            of.iter().sum::<f64>() / of.len() as f64
        };
        let profile: Vec<f64> = (0..rings).map(mean).collect();
        let height = profile.iter().copied().fold(0.0, f64::max);
        let first_below = |share: f64| {
            let ring = profile.iter().position(|mean| *mean < share * height);
            ring.unwrap_or(rings) as f64 * self.spacing_m
        };
        let (upper, lower) = (first_below(0.8), first_below(0.2));
        let flank: Vec<_> = surface.into_iter().filter(|p| p[0] >= upper && p[0] < lower).collect();
        if flank.len() < 3 { 0.0 } else { -libm::atan(line(&flank)[1]) }
    }
}

/// Volume of particles over the volume of balls that lie within the powder: one number for each ball.
///
/// A ball's surface is as soft as a particle is wide: what lies in it counts by how far it is inside, so that
/// the number does not jump with every particle. Centres lie on a cubic lattice. A ball lies within if there
/// is powder around it on all sides: particles in the shell between its radius and 1.7 times that, in each of
/// the eight octants and close to each of the six directions of the axes.
pub(super) fn packing(particles: &[[f64; 3]], volume_m3: f64, radius_m: f64, step_m: f64) -> Vec<f64> {
    let (reach, width) = (1.7 * radius_m, libm::cbrt(volume_m3));
    let bins = Bins::new(particles, reach);
    // The integral of the soft ball.
    let ball_m3 = 4.0 / 3.0 * core::f64::consts::PI * radius_m * (radius_m * radius_m + 0.25 * width * width);
    let seen = |centre: [f64; 3]| {
        let (mut inside, mut octants, mut axes) = (0.0, [false; 8], [false; 6]);
        for p in bins.near(centre) {
            let d = [0, 1, 2].map(|a| p[a] - centre[a]);
            let far = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
            inside += (0.5 + (radius_m - far) / width).clamp(0.0, 1.0);
            if far > radius_m && far < reach {
                octants[(0..3).map(|a| usize::from(d[a] > 0.0) << a).sum::<usize>()] = true;
                for a in (0..3).filter(|a| d[*a].abs() > 0.8 * far) {
                    axes[2 * a + usize::from(d[a] > 0.0)] = true;
                }
            }
        }
        let within = octants.iter().chain(&axes).all(|there| *there);
        within.then_some(inside * volume_m3 / ball_m3)
    };
    bins.lattice(step_m).into_iter().filter_map(seen).collect()
}

/// Particles by cubes of space.
struct Bins {
    low: [f64; 3],
    high: [f64; 3],
    edge: f64,
    counts: [usize; 3],
    bins: Vec<Vec<[f64; 3]>>,
}

impl Bins {
    fn new(particles: &[[f64; 3]], edge: f64) -> Self {
        let end = |from: f64, pick: fn(f64, f64) -> f64| {
            [0, 1, 2].map(|a| particles.iter().map(|p| p[a]).fold(from, pick))
        };
        let (low, high) = (end(f64::INFINITY, f64::min), end(f64::NEG_INFINITY, f64::max));
        let counts = [0, 1, 2].map(|a| ((high[a] - low[a]) / edge) as usize + 1);
        let mut bins = Self { low, high, edge, counts, bins: vec![Vec::new(); counts.iter().product()] };
        for p in particles {
            let at = bins.place(*p);
            let index = bins.index(at);
            bins.bins[index].push(*p);
        }
        bins
    }

    fn place(&self, p: [f64; 3]) -> [usize; 3] {
        [0, 1, 2].map(|a| (((p[a] - self.low[a]) / self.edge) as usize).min(self.counts[a] - 1))
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (x * self.counts[1] + y) * self.counts[2] + z
    }

    /// All that may be nearer than an edge, and more.
    fn near(&self, p: [f64; 3]) -> impl Iterator<Item = &[f64; 3]> {
        let at = self.place(p);
        let range = move |a: usize| at[a].saturating_sub(1)..(at[a] + 2).min(self.counts[a]);
        let places = range(0).flat_map(move |x| range(1).flat_map(move |y| range(2).map(move |z| [x, y, z])));
        places.flat_map(|at| &self.bins[self.index(at)])
    }

    /// Points of a cubic lattice over the whole of it.
    fn lattice(&self, step: f64) -> Vec<[f64; 3]> {
        let counts = [0, 1, 2].map(|a| ((self.high[a] - self.low[a]) / step) as usize);
        let [nx, ny, nz] = counts;
        let at = |n: usize| [n / (ny * nz), n / nz % ny, n % nz];
        let point = |n: usize| {
            let at = at(n);
            [0, 1, 2].map(|a| self.low[a] + step * (at[a] as f64 + 0.5))
        };
        (0..nx * ny * nz).map(point).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPACING: f64 = 0.002;
    const VOLUME: f64 = SPACING * SPACING * SPACING;

    /// A lattice in a box about the axis, jittered by most of a sub-cell, that is below a surface.
    fn below(surface: impl Fn(f64) -> f64, half: f64, height: f64) -> Vec<[f64; 3]> {
        let mut dice = crate::mpm::tests::Dice::new(7);
        let count = |length: f64| (length / SPACING) as usize;
        let (n, m) = (count(2.0 * half), count(height));
        let mut out = Vec::new();
        for k in 0..n * n * m {
            let cell = [k % n, k / n % n, k / (n * n)];
            let p = [0, 1, 2].map(|a| SPACING * (cell[a] as f64 + 0.5 + 0.45 * dice.roll()));
            let p = [p[0] - half, p[1] - half, p[2]];
            if p[2] < surface(libm::hypot(p[0], p[1])) {
                out.push(p);
            }
        }
        out
    }

    fn deposit(surface: impl Fn(f64) -> f64, half: f64, height: f64) -> Deposit {
        // Anywhere but at the origin.
        let moved: Vec<_> =
            below(surface, half, height).iter().map(|p| [p[0] + 0.1, p[1] + 0.3, p[2]]).collect();
        Deposit::new(&moved, [0.1, 0.3], VOLUME)
    }

    fn assert_near(found: f64, wanted: f64, tolerance: f64) {
        assert!((found - wanted).abs() < tolerance, "{found} instead of {wanted}");
    }

    #[test]
    fn quantiles_lie_between_their_neighbours() {
        let numbers = [4.0, 1.0, 3.0, 2.0, 5.0];
        for (share, wanted) in [(0.0, 1.0), (0.5, 3.0), (0.9, 4.6), (1.0, 5.0)] {
            assert_near(quantile(&numbers, share), wanted, 1e-12);
        }
        assert!(quantile(&[], 0.5).is_nan());
    }

    #[test]
    fn a_line_is_found_again() {
        let points: Vec<_> = (0..9).map(|x| [f64::from(x), 3.0 - 0.5 * f64::from(x)]).collect();
        let [at_zero, slope] = line(&points);
        assert_near(at_zero, 3.0, 1e-12);
        assert_near(slope, -0.5, 1e-12);
    }

    #[test]
    fn a_cone_has_its_height_slope_and_foot() {
        for degrees in [20.0f64, 30.0, 40.0] {
            let tangent = libm::tan(degrees.to_radians());
            let radius = 0.050;
            let cone = deposit(|r| tangent * (radius - r), radius, tangent * radius + SPACING);
            // A tenth of a spacing is what the two kinds of packing leave open.
            assert_near(cone.apex(0.6 * radius), tangent * radius, 0.15 * SPACING);
            assert_near(cone.slope().to_degrees(), degrees, 0.4);
            // Where the cone is one spacing high.
            assert_near(cone.front(), radius - SPACING / tangent, 0.7 * SPACING);
            // The volume beyond a share s of the radius is 1 - 3 s^2 + 2 s^3 of it.
            let beyond = |s: f64| 1.0 - 3.0 * s * s + 2.0 * s * s * s;
            let share = 1.0 - beyond(0.8);
            assert_near(cone.radius_of(share), 0.8 * radius, 0.5 * SPACING);
        }
    }

    #[test]
    fn a_disc_has_its_height_and_edge() {
        let (radius, height) = (0.040, 0.012);
        let disc = deposit(|r| if r < radius { height } else { 0.0 }, 0.05, 0.02);
        assert_near(disc.apex(0.6 * radius), height, 0.1 * SPACING);
        assert_near(disc.front(), radius, SPACING);
        assert_near(disc.radius_of(0.99), radius * 0.99f64.sqrt(), 0.1 * SPACING);
        // One spacing thick is no more than that.
        let skin = deposit(|r| if r < radius { 0.9 * SPACING } else { 0.0 }, 0.05, 0.004);
        assert!(skin.front() < radius - SPACING, "{}", skin.front());
    }

    #[test]
    fn a_level_bed_has_no_slope() {
        assert_near(deposit(|_| 0.01, 0.05, 0.012).slope(), 0.0, 1e-12);
        assert_near(Deposit::new(&[], [0.0; 2], VOLUME).slope(), 0.0, 1e-12);
    }

    #[test]
    fn packing_is_what_it_is_and_balls_at_the_surface_do_not_count() {
        for stretch in [1.0f64, 1.25, 0.8] {
            let points: Vec<_> =
                below(|_| 1.0, 0.020, 0.03).iter().map(|p| [p[0], p[1], p[2] * stretch]).collect();
            let found = packing(&points, VOLUME, 0.004, 0.0015);
            assert!(found.len() > 500, "{}", found.len());
            assert_near(quantile(&found, 0.5), 1.0 / stretch, 0.03 / stretch);
            // Some thirty particles to a ball.
            for (share, wanted) in [(0.1, 0.95), (0.9, 1.05)] {
                println!("{}", quantile(&found, share) * stretch);
                assert_near(quantile(&found, share) * stretch, wanted, 0.04);
            }
        }
        // A layer thinner than a ball holds none.
        assert!(packing(&below(|_| 1.0, 0.020, 0.006), VOLUME, 0.004, 0.0015).is_empty());
    }
}
