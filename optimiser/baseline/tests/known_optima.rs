//! Searches on functions whose optimum is known.

use powderline_baseline::{CmaEs, RandomSearch, Search};

const DIMENSION: usize = 5;

/// The lowest loss that `search` finds within `budget` evaluations, and where.
fn minimise(search: &mut dyn Search, loss: impl Fn(&[f64]) -> f64, budget: usize) -> (f64, Vec<f64>) {
    let mut best = (f64::INFINITY, Vec::new());
    let mut left = budget;
    while left > 0 {
        let points = search.ask(left);
        assert!(!points.is_empty() && points.len() <= left);
        let losses: Vec<f64> = points.iter().map(|point| loss(point)).collect();
        for (point, &value) in points.iter().zip(&losses) {
            assert!(point.len() == DIMENSION && point.iter().all(|x| x.abs() <= 1.0), "{point:?}");
            if value < best.0 {
                best = (value, point.clone());
            }
        }
        left -= points.len();
        search.tell(&losses);
    }
    best
}

fn sphere_at(optimum: [f64; DIMENSION]) -> impl Fn(&[f64]) -> f64 {
    move |x| x.iter().zip(optimum).map(|(x, o)| (x - o).powi(2)).sum()
}

/// Axes of very different length, turned by a Householder reflection so that none lies along a coordinate.
fn rotated_ellipsoid(x: &[f64]) -> f64 {
    let shifted: Vec<f64> = x.iter().enumerate().map(|(i, x)| x - 0.1 * (i as f64 - 2.0)).collect();
    let normal = [1.0, -2.0, 3.0, 0.5, -1.0];
    let length: f64 = normal.iter().map(|n| n * n).sum();
    let along = 2.0 * shifted.iter().zip(normal).map(|(x, n)| x * n).sum::<f64>() / length;
    let turned = shifted.iter().zip(normal).map(|(x, n)| x - along * n);
    turned.enumerate().map(|(i, y)| 10_f64.powf(4.0 * i as f64 / 4.0) * y * y).sum()
}

/// Rosenbrock's valley on [-2, 2]^5, its optimum at 0.5.
fn rosenbrock(x: &[f64]) -> f64 {
    let x: Vec<f64> = x.iter().map(|x| 2.0 * x).collect();
    x.windows(2).map(|p| 100.0 * (p[1] - p[0] * p[0]).powi(2) + (1.0 - p[0]).powi(2)).sum()
}

fn largest_distance(point: &[f64], optimum: [f64; DIMENSION]) -> f64 {
    point.iter().zip(optimum).map(|(x, o)| (x - o).abs()).fold(0.0, f64::max)
}

#[test]
fn random_search_covers_the_box() {
    let points = RandomSearch::new(DIMENSION, 7).ask(10_000);
    assert_eq!(points.len(), 10_000);
    for axis in 0..DIMENSION {
        let column = || points.iter().map(|point| point[axis]);
        let mean: f64 = column().sum::<f64>() / 1e4;
        let square: f64 = column().map(|x| x * x).sum::<f64>() / 1e4;
        assert!(column().all(|x| (-1.0..1.0).contains(&x)));
        // Five standard deviations of the two means over 10,000 uniform numbers.
        assert!(mean.abs() < 0.029 && (square - 1.0 / 3.0).abs() < 0.015, "{axis}: {mean} {square}");
    }
    for corner in 0..1 << DIMENSION {
        let inside = |point: &&Vec<f64>| (0..DIMENSION).all(|i| (point[i] > 0.0) == (corner >> i & 1 == 1));
        // 312 are expected, with a standard deviation of 17.
        assert!(points.iter().filter(inside).count() > 220);
    }
}

#[test]
fn random_search_asks_for_what_is_wanted_and_ignores_losses() {
    let (mut one, mut other) = (RandomSearch::new(DIMENSION, 1), RandomSearch::new(DIMENSION, 1));
    let apart: Vec<_> = (0..6).flat_map(|_| one.ask(1)).collect();
    one.tell(&[1.0]);
    assert_eq!(apart, other.ask(6));
    assert_eq!(one.ask(0).len(), 1);
}

#[test]
fn cmaes_finds_a_sphere_and_a_rotated_ellipsoid() {
    for seed in 0..5 {
        let optimum = [0.3, -0.7, 0.0, 0.9, -0.2];
        let (loss, _) = minimise(&mut CmaEs::new(DIMENSION, seed), sphere_at(optimum), 1500);
        assert!(loss < 1e-8, "sphere, seed {seed}: {loss:e}");
        let (loss, _) = minimise(&mut CmaEs::new(DIMENSION, seed), rotated_ellipsoid, 4000);
        assert!(loss < 1e-8, "ellipsoid, seed {seed}: {loss:e}");
    }
}

#[test]
fn cmaes_finds_the_end_of_rosenbrocks_valley() {
    // A second local minimum lies at x1 = -1; the restarts lead out of it.
    for seed in 0..5 {
        let (loss, point) = minimise(&mut CmaEs::new(DIMENSION, seed), rosenbrock, 20_000);
        assert!(
            loss < 1e-8 && largest_distance(&point, [0.5; 5]) < 1e-3,
            "seed {seed}: {loss:e} at {point:?}"
        );
    }
}

#[test]
fn cmaes_finds_an_optimum_on_the_boundary() {
    for seed in 0..5 {
        // On a face, and in a corner beyond which the loss would fall further.
        for optimum in [[1.0_f64, 0.2, -0.4, 0.0, 0.6], [1.0, -1.0, 1.0, 1.0, -1.0]] {
            let loss = |x: &[f64]| {
                let slope: f64 =
                    (0..DIMENSION).filter(|&i| optimum[i].abs() > 0.9).map(|i| 1.0 - x[i] * optimum[i]).sum();
                slope + sphere_at(optimum)(x)
            };
            let (loss, point) = minimise(&mut CmaEs::new(DIMENSION, seed), loss, 3000);
            assert!(
                loss < 1e-8 && largest_distance(&point, optimum) < 1e-4,
                "seed {seed}: {loss:e} at {point:?}"
            );
        }
    }
}

#[test]
fn cmaes_does_not_depend_on_the_pieces_its_generations_come_in() {
    let loss = sphere_at([0.1, 0.2, 0.3, 0.4, 0.5]);
    let asked = |most: usize| {
        let mut search = CmaEs::new(DIMENSION, 3);
        let mut points = Vec::new();
        while points.len() < 80 {
            let piece = search.ask(most);
            search.tell(&piece.iter().map(|point| loss(point)).collect::<Vec<_>>());
            points.extend(piece);
        }
        points.truncate(80);
        points
    };
    assert_eq!(CmaEs::new(DIMENSION, 3).population(), 8);
    assert_eq!(asked(1), asked(8));
    assert_eq!(asked(3), asked(8));
}

#[test]
fn cmaes_survives_losses_that_say_nothing() {
    for useless in [1.0, f64::NAN, f64::INFINITY] {
        minimise(&mut CmaEs::new(DIMENSION, 1), |_| useless, 4000);
    }
}

#[test]
fn replaying_told_losses_gives_the_same_next_points() {
    let make: [fn(u64) -> Box<dyn Search>; 2] =
        [|seed| Box::new(RandomSearch::new(DIMENSION, seed)), |seed| Box::new(CmaEs::new(DIMENSION, seed))];
    for make in make {
        let loss = sphere_at([-0.5, 0.5, 0.25, 0.0, -0.25]);
        let mut first = make(11);
        let mut told = Vec::new();
        for _ in 0..25 {
            let points = first.ask(8);
            let losses: Vec<f64> = points.iter().map(|point| loss(point)).collect();
            first.tell(&losses);
            told.push((points, losses));
        }
        let mut again = make(11);
        for (points, losses) in &told {
            assert_eq!(&again.ask(8), points);
            again.tell(losses);
        }
        assert_eq!(first.ask(8), again.ask(8));
        assert_ne!(make(11).ask(8), make(12).ask(8));
    }
}
