//! Where the powder ended up.

use crate::scene::{Container, ContainerShape, Scene};
use powderline_shared::{census::Census, pose::Pose};

/// Powder that moves faster is not at rest, m/s: a grain has fallen for 5 ms, over an eighth of a millimetre.
pub(super) const AT_REST_M_S: f64 = 0.05;

/// A particle may stand in a wall's surface by this share of its thickness, as contact is soft.
const IN_WALL: f64 = 0.25;

/// Where a particle is when all is over: the six places of a [`Census`]. The first that fits counts, from `Target` on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Destination {
    /// In the source or another container that is not the target (comes third), or heaped above
    /// its rim (comes fifth).
    Source,
    /// In the target: between its inner walls, above its floor and below its rim. Comes first.
    Target,
    /// On a container's wall, or above the target's rim, as the top of a heap in a full one. Comes sixth.
    Rims,
    /// On the tool: in the ball around a bowl's inside, in the box around a scoop's or around
    /// cuboids, with as much room above as below. Powder around a tool that still stands in the bed
    /// counts, too. Comes second.
    Tool,
    /// Above no container and not on the tool. Comes last.
    Spilled,
    /// Below no container's rim, and faster than 0.05 m/s. Comes fourth.
    InFlight,
}

impl Destination {
    /// All six, in the order of [`Census::named`].
    pub const ALL: [Self; 6] =
        [Self::Source, Self::Target, Self::Rims, Self::Tool, Self::Spilled, Self::InFlight];

    /// Its name in files, that of the place in a [`Census`].
    pub fn name(self) -> &'static str {
        Census::default().named()[self as usize].0
    }
}

/// Particles at the end of a motion, by identity.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grains<'a> {
    /// Metres.
    pub(crate) positions: &'a [[f64; 3]],
    /// Metres per second.
    pub(crate) velocities: &'a [[f64; 3]],
}

pub(crate) fn census(scene: &Scene, grains: Grains<'_>, tool: &Pose) -> Census {
    let mut census = Census::default();
    for destination in destinations(scene, grains, tool) {
        *match destination {
            Destination::Source => &mut census.source,
            Destination::Target => &mut census.target,
            Destination::Rims => &mut census.rims,
            Destination::Tool => &mut census.tool,
            Destination::Spilled => &mut census.spilled,
            Destination::InFlight => &mut census.in_flight,
        } += 1;
    }
    census
}

/// Where each particle is when the motion is over.
pub(crate) fn destinations(scene: &Scene, grains: Grains<'_>, tool: &Pose) -> Vec<Destination> {
    let of = |(p, v): (&[f64; 3], &[f64; 3])| destination(scene, tool, p, v);
    grains.positions.iter().zip(grains.velocities).map(of).collect()
}

fn destination(scene: &Scene, tool: &Pose, p: &[f64; 3], v: &[f64; 3]) -> Destination {
    let places = || scene.containers.iter().map(|c| (c, place(c, p)));
    let is_target = |c: &Container| c.name == scene.objective.target;
    let [vx, vy, vz] = v;
    if places().any(|(c, place)| is_target(c) && place == Place::Inside) {
        Destination::Target
    } else if held(scene, tool, p) {
        Destination::Tool
    } else if places().any(|(_, place)| place == Place::Inside) {
        Destination::Source
    } else if libm::hypot(libm::hypot(*vx, *vy), *vz) > AT_REST_M_S {
        Destination::InFlight
    } else if places().any(|(c, place)| !is_target(c) && place == Place::Above) {
        Destination::Source
    } else if places().any(|(_, place)| place != Place::Outside) {
        Destination::Rims
    } else {
        Destination::Spilled
    }
}

/// Where a point is, as one container sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    /// Between its walls, below its rim.
    Inside,
    /// Between its walls, above its rim.
    Above,
    /// In its wall, or above that.
    Wall,
    /// Beside it, or leaning against it.
    Outside,
}

fn place(c: &Container, p: &[f64; 3]) -> Place {
    let ([x, y, z], wall) = (c.local_m(p), c.wall_thickness_m);
    // From the inner face outwards.
    let gap = match c.shape {
        ContainerShape::Box { inner_size_m: [lx, ly, _] }
        | ContainerShape::SlottedBox { inner_size_m: [lx, ly, _], .. } => {
            (x.abs() - 0.5 * lx).max(y.abs() - 0.5 * ly)
        }
        ContainerShape::Cylinder { inner_radius_m, .. } | ContainerShape::Silo { inner_radius_m, .. } => {
            libm::hypot(x, y) - inner_radius_m
        }
        ContainerShape::Hopper { inner_radius_m, outlet_radius_m, half_angle_deg, .. } => {
            let (rho, (sin, cos)) = (libm::hypot(x, y), libm::sincos(half_angle_deg.to_radians()));
            (rho - inner_radius_m).max(cos * (rho - outlet_radius_m) - sin * z)
        }
    };
    let is_below_rim = z <= c.inner_height_m();
    match () {
        // Below the floor, which is as thick as the walls, or the hole.
        () if z < -wall => Place::Outside,
        () if gap <= IN_WALL * wall && is_below_rim => Place::Inside,
        () if gap <= IN_WALL * wall => Place::Above,
        // What leans against the wall from outside stands in its surface, too.
        () if gap > if is_below_rim { (1.0 - IN_WALL) * wall } else { wall } => Place::Outside,
        () => Place::Wall,
    }
}

/// On the tool, whose walls powder may lie upon.
pub(super) fn held(scene: &Scene, tool: &Pose, p: &[f64; 3]) -> bool {
    held_within(scene, tool, p, scene.tool.wall_thickness_m)
}

/// The same with so much room around it, metres.
pub(super) fn held_within(scene: &Scene, tool: &Pose, p: &[f64; 3], room_m: f64) -> bool {
    scene.tool.carries(tool.tool_from_world(&(*p).into()).into(), room_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A vial of 12 mm inside radius with walls of 2 mm, 40 mm high, that stands at the origin.
    fn vial() -> Container {
        Container {
            name: "vial".into(),
            position_m: [0.0; 3],
            yaw_deg: 0.0,
            wall_thickness_m: 0.002,
            friction: 0.4,
            shape: ContainerShape::Cylinder { inner_radius_m: 0.012, inner_height_m: 0.04 },
        }
    }

    #[test]
    fn a_container_sees_its_inside_its_wall_and_what_is_above() {
        let (inner_radius_m, inner_height_m) = (0.012, 0.04);
        let shape = ContainerShape::Silo { inner_radius_m, inner_height_m, outlet_radius_m: 0.004 };
        // What has come through a hole is below the floor, as nothing else can be.
        [vial(), Container { shape, ..vial() }].iter().for_each(sees);
    }

    #[test]
    fn a_hopper_sees_its_cone() {
        let shape = ContainerShape::Hopper {
            inner_radius_m: 0.012,
            inner_height_m: 0.04,
            outlet_radius_m: 0.004,
            half_angle_deg: 45.0,
        };
        let hopper = Container { shape, ..vial() };
        for (x_mm, z_mm, expected) in [
            (0.0, 1.0, Place::Inside),
            (4.4, 0.1, Place::Inside),
            (11.9, 8.1, Place::Inside),
            (12.4, 39.9, Place::Inside),
            (0.0, -2.1, Place::Outside),
            // Across the wall from its inner face: 1.41 and 1.56 mm.
            (7.0, 1.0, Place::Wall),
            (7.2, 1.0, Place::Outside),
            (11.9, 40.1, Place::Above),
            (13.0, 20.0, Place::Wall),
            (13.6, 20.0, Place::Outside),
        ] {
            let found = place(&hopper, &[0.0, -1e-3 * x_mm, 1e-3 * z_mm]);
            assert_eq!(found, expected, "{x_mm} mm from the axis, {z_mm} mm above the hole");
        }
    }

    #[test]
    fn a_slotted_box_sees_what_has_come_through_outside() {
        let shape = ContainerShape::SlottedBox { inner_size_m: [0.02, 0.03, 0.04], slot_width_m: 0.008 };
        let container = Container { shape, ..vial() };
        for (p_mm, expected) in [
            ([0.0, 0.0, 1.0], Place::Inside),
            ([9.9, 14.9, 39.9], Place::Inside),
            ([3.9, 0.0, -1.9], Place::Inside),
            ([3.9, 0.0, -2.1], Place::Outside),
            ([9.9, 14.9, 40.1], Place::Above),
            ([11.0, 0.0, 20.0], Place::Wall),
            ([0.0, 17.6, 20.0], Place::Outside),
        ] {
            assert_eq!(place(&container, &p_mm.map(|mm| 1e-3 * mm)), expected, "{p_mm:?}");
        }
    }

    fn sees(container: &Container) {
        for (x_mm, z_mm, expected) in [
            (0.0, 1.0, Place::Inside),
            (12.4, 39.9, Place::Inside),
            (0.0, -1.9, Place::Inside),
            (0.0, -2.1, Place::Outside),
            (11.9, 40.1, Place::Above),
            (12.6, 40.1, Place::Wall),
            (13.9, 40.1, Place::Wall),
            (14.1, 40.1, Place::Outside),
            (13.0, 20.0, Place::Wall),
            (13.6, 20.0, Place::Outside),
        ] {
            let found = place(container, &[0.0, -1e-3 * x_mm, 1e-3 * z_mm]);
            assert_eq!(found, expected, "{x_mm} mm from the axis, {z_mm} mm above the floor");
        }
    }

    #[test]
    fn destinations_have_the_names_of_the_census() {
        let names = Destination::ALL.map(Destination::name);
        assert_eq!(names, ["source", "target", "rims", "tool", "spilled", "in_flight"]);
    }

    #[test]
    fn powder_on_the_rim_is_neither_left_nor_spilled() {
        let mut scene = Scene::load("vial").expect("it comes along");
        let index = scene.containers.iter().position(|c| c.name == scene.objective.target).expect("a target");
        let [x, y, z] = scene.containers[index].position_m;
        scene.containers[index] =
            Container { position_m: [x, y, z], name: scene.objective.target.clone(), ..vial() };
        let [source_x, source_y, source_z] = scene.containers[1 - index].position_m;
        let tool = Pose { position_m: [0.0, 0.0, 9.0].into(), ..Pose::identity() };
        let rest = [0.0; 3];
        let falls = [0.0, 0.0, -0.3];
        for (p, v, expected) in [
            ([x, y, z + 0.02], falls, Destination::Target),
            ([x + 0.013, y, z + 0.0405], rest, Destination::Rims),
            ([x, y, z + 0.0405], rest, Destination::Rims),
            ([x, y, z + 0.0405], falls, Destination::InFlight),
            ([x + 0.0136, y, z + 0.01], rest, Destination::Spilled),
            ([source_x, source_y, source_z + 0.005], falls, Destination::Source),
            ([source_x, source_y, source_z + 0.5], rest, Destination::Source),
        ] {
            assert_eq!(destination(&scene, &tool, &p, &v), expected, "{p:?} {v:?}");
        }
    }
}
