//! What a shape answers to one question agrees with what it answers to the others.

use super::*;

const WALL_M: f64 = 0.002;

/// One of each, about as large.
fn shapes() -> [ToolShape; 3] {
    let cuboid = |centre_m, size_m| Cuboid { centre_m, size_m, rotation_deg: [0.0; 3] };
    // A tray that is open in front, the left wall of which leans outwards.
    let left = Cuboid {
        centre_m: [0.0, 0.012, -0.005],
        size_m: [0.026, WALL_M, 0.014],
        rotation_deg: [-20.0, 0.0, 0.0],
    };
    let tray = vec![
        cuboid([0.0, 0.0, -0.011], [0.026, 0.022, WALL_M]),
        cuboid([-0.012, 0.0, -0.005], [WALL_M, 0.022, 0.012]),
        cuboid([0.0, -0.010, -0.005], [0.026, WALL_M, 0.012]),
        left,
    ];
    [
        ToolShape::Bowl { inner_radius_m: 0.012 },
        ToolShape::BoxScoop { inner_size_m: [0.024, 0.018, 0.010] },
        ToolShape::Cuboids { cuboid: tray },
    ]
}

/// Points in a box that is larger than each of them, half a millimetre apart.
fn points() -> impl Iterator<Item = Point> {
    let along = || (-40..=40).map(|step| 5e-4 * f64::from(step) + 1e-5);
    along().flat_map(move |x| along().flat_map(move |y| along().map(move |z| [x, y, z])))
}

/// What lies beyond a surface by less is not looked at: the grid of points, and the bowl's rim, which is round.
const SLACK_M: f64 = 0.5 * WALL_M + 1e-4;

const DIRECTIONS: [Point; 8] = [
    [1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, -1.0, 0.0],
    [0.0, 0.0, 1.0],
    [0.0, 0.0, -1.0],
    [0.6, 0.0, -0.8],
    [-0.48, 0.64, 0.6],
];

fn of_each(look: impl Fn(&dyn Body, &str)) {
    for shape in shapes() {
        shape.with_body(WALL_M, |body| look(body, &format!("{shape:?}")));
    }
}

/// From a point to the nearest wall, negative within one.
fn to_wall_m(body: &dyn Body, point: Point) -> f64 {
    body.solids().iter().map(|solid| solid.distance_at(point)).fold(f64::INFINITY, f64::min)
}

#[test]
fn a_body_reaches_as_far_as_its_walls() {
    of_each(|body, shape| {
        let solids = body.solids();
        let in_wall = |point: &Point| solids.iter().any(|solid| solid.distance_at(*point) <= 0.0);
        let material: Vec<Point> = points().filter(in_wall).collect();
        let far =
            |reach: &dyn Fn(&Point) -> f64| material.iter().map(reach).fold(f64::NEG_INFINITY, f64::max);
        for direction in DIRECTIONS {
            let gap_m = body.support(direction) - far(&|point| dot(*point, direction));
            assert!(gap_m.abs() <= SLACK_M, "{shape} along {direction:?}: {gap_m}");
            let lip_m = body.lip_m(direction);
            assert!(lip_m <= body.support(direction), "{shape} along {direction:?}: {lip_m}");
        }
        let gap_m = body.bounding_radius_m() - far(&|point| libm::sqrt(dot(*point, *point)));
        assert!(gap_m.abs() <= SLACK_M, "{shape}: {gap_m}");
        // The lip is where the walls end in front.
        let lip = body.lip_m([1.0, 0.0, 0.0]) - body.support([1.0, 0.0, 0.0]);
        assert!((-WALL_M - 1e-12..=0.0).contains(&lip), "{shape}: {lip}");
    });
}

#[test]
fn handle_and_edge_are_at_the_walls() {
    of_each(|body, shape| {
        let behind_m = |x_m: f64| to_wall_m(body, [-x_m, 0.0, 0.0]);
        assert!(behind_m(body.rear_m()) <= 1e-9, "{shape}");
        let beside = [-0.6, 0.6].map(|walls| behind_m(body.rear_m() + walls * WALL_M));
        assert!(beside.iter().all(|gap_m| *gap_m > 0.0), "{shape}: not the middle of the wall");
        let edge = body.edge();
        assert!(edge.len() > 50, "{shape}");
        for point in edge {
            let gap_m = to_wall_m(body, point);
            assert!(gap_m.abs() <= SLACK_M, "{shape} at {point:?}: {gap_m}");
        }
    });
}

#[test]
fn the_cavity_is_between_the_walls() {
    of_each(|body, shape| {
        let below_rim = points().filter(|point| point[2] <= 0.0);
        let cavity: Vec<Point> = below_rim.filter(|point| body.encloses(*point)).collect();
        assert!(cavity.len() > 10_000, "{shape}: {}", cavity.len());
        let turned = |[x, y, z]: Point| [0.8 * x + 0.6 * z, y, 0.8 * z - 0.6 * x];
        let extent = body.cavity_extent_m(&turned);
        for point in &cavity {
            assert!(to_wall_m(body, *point) >= -1e-12, "{shape} at {point:?}");
            assert!(body.carries(*point, 0.0), "{shape} at {point:?}");
            let there = turned(*point);
            assert!(
                (0..3).all(|k| (extent[k][0]..=extent[k][1]).contains(&there[k])),
                "{shape} at {point:?}"
            );
        }
        // Above it is the open, below it a wall, and powder beyond both is not on it.
        assert!(body.is_open_at([0.0, 0.0, 0.003]) && !body.is_open_at([0.0, 0.0, -0.0111]), "{shape}");
        let beyond = DIRECTIONS.map(|along| along.map(|x| 0.04 * x));
        assert!(beyond.iter().all(|point| !body.carries(*point, WALL_M)), "{shape}");
        let across = |axis: usize| {
            let low = cavity.iter().map(|point| point[axis]).fold(f64::INFINITY, f64::min);
            cavity.iter().map(|point| point[axis]).fold(f64::NEG_INFINITY, f64::max) - low
        };
        let gap_m = 2.0 * body.half_width_m() - across(0).min(across(1));
        assert!((-1e-3..=2.5 * WALL_M).contains(&gap_m), "{shape}: {gap_m}");
    });
}
