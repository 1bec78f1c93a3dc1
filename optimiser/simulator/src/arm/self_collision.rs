//! Whether an arm passes through itself, or through the tool that it holds.
//!
//! | part | passes through |
//! |---|---|
//! | forearm, wrists 1 to 3 | base and shoulder |
//! | wrists 1 to 3 | upper arm |
//! | wrist 3 | forearm |
//! | tool | base and shoulder, upper arm, forearm, wrists 1 and 2 |
//!
//! Parts are the capsules that are kept from everything else. For upper arm and forearm these are 30 to 65 mm wider than the links,
//! by which many a posture would be refused that is none too near: to the other links, and the forearm to the base, they are boxes. To the tool
//! they are capsules all the same.
//!
//! What is left out: parts that are joined, and the upper arm beside the base and wrist 3 beside wrist 1, at distances that no joint changes. Wrist 2
//! turns beside the forearm likewise; where its far end points into that, wrist 3 is in the forearm as well. The tool is joined to wrist 3 by what
//! nobody knows.

use super::surroundings::least;
use crate::scene::ToolPart;
use crate::shape::{Capsule, OrientedBox, Shape};
use nalgebra::Vector3;
use powderline_shared::arm::links::{Link, axes, base_from_flange, column_axis, normal};
use powderline_shared::arm::{ArmFigures, ArmKind, ArmModel, Joints};
use powderline_shared::pose::Pose;
use std::fmt;

/// A part of an arm that holds a tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Base and shoulder, which are one capsule.
    Column,
    /// What moves beyond them.
    Link(Link),
    /// What it holds.
    Tool(ToolPart),
}

impl Part {
    /// Such as "its forearm", where the arm is `its`.
    fn words(self, its: &str) -> String {
        match self {
            Self::Column => format!("{its} base or shoulder"),
            Self::Link(link) => format!("{its} {}", link.name()),
            Self::Tool(part) => format!("the {part}"),
        }
    }
}

impl fmt::Display for Part {
    /// Such as "its forearm".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.words("its"))
    }
}

/// Two parts that cannot be where they would be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// The one nearer to the tool.
    pub part: Part,
    /// What it is in.
    pub other: Part,
    /// How deep, metres.
    pub depth_m: f64,
}

impl fmt::Display for Contact {
    /// Such as "pass through its forearm, 3.0 mm deep".
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // What the tool meets is not its own.
        let its = if let Part::Tool(_) = self.part { "the arm's" } else { "its" };
        write!(f, "pass through {}, {:.1} mm deep", self.other.words(its), 1e3 * self.depth_m)
    }
}

/// What links may pass through: other links, or the column.
const PAIRS: [(Link, Option<Link>); 8] = [
    (Link::Forearm, None),
    (Link::Wrist1, None),
    (Link::Wrist1, Some(Link::UpperArm)),
    (Link::Wrist2, None),
    (Link::Wrist2, Some(Link::UpperArm)),
    (Link::Wrist3, None),
    (Link::Wrist3, Some(Link::UpperArm)),
    (Link::Wrist3, Some(Link::Forearm)),
];

/// What the tool may pass through.
const FROM_TOOL: [Option<Link>; 5] =
    [None, Some(Link::UpperArm), Some(Link::Forearm), Some(Link::Wrist1), Some(Link::Wrist2)];

/// The first two parts that pass through each other where the joints are so; `tool` in the tool's frame.
pub(super) fn contact(model: &ArmModel, joints: &Joints, tool: &[(ToolPart, Shape<f64>)]) -> Option<Contact> {
    let capsules = Capsules::at(model.kind, joints);
    let named = |link: Option<Link>| link.map_or(Part::Column, Part::Link);
    let in_itself = |(link, other): (Link, Option<Link>)| {
        let depth_m = capsules.depth_m(link, other)?;
        Some(Contact { part: Part::Link(link), other: named(other), depth_m })
    };
    let base_from_tool = base_from_flange(model.kind, joints).then(&model.flange_from_tool);
    let in_tool = |link: Option<Link>| {
        let held = capsules.of(link).seen_from(&base_from_tool);
        let deep = |(part, solid): &(ToolPart, Shape<f64>)| Some((*part, held.depth_in(solid)?));
        let (part, depth_m) = tool.iter().find_map(deep)?;
        Some(Contact { part: Part::Tool(part), other: named(link), depth_m })
    };
    PAIRS.into_iter().find_map(in_itself).or_else(|| FROM_TOOL.into_iter().find_map(in_tool))
}

/// The capsules that hold an arm, base coordinates.
struct Capsules {
    column: Held,
    links: [Held; 5],
    /// Across the plane of upper arm and forearm.
    normal: Vector3<f64>,
    figures: &'static ArmFigures,
}

/// A capsule.
#[derive(Clone, Copy)]
struct Held {
    /// Both ends of its axis, metres.
    axis: [Vector3<f64>; 2],
    radius_m: f64,
}

impl Capsules {
    fn at(kind: ArmKind, joints: &Joints) -> Self {
        let (axes, figures) = (axes(kind, joints), kind.figures());
        Self {
            column: Held { axis: column_axis(kind), radius_m: figures.column_radius_m },
            links: std::array::from_fn(|k| Held { axis: axes[k], radius_m: Link::ALL[k].radius_m(kind) }),
            normal: normal(kind, joints),
            figures,
        }
    }

    /// Of a link, or of the column.
    fn of(&self, link: Option<Link>) -> Held {
        link.map_or(self.column, |link| self.links[link as usize])
    }

    /// How deep a link is in another one, or in the column; none if it is not.
    fn depth_m(&self, link: Link, other: Option<Link>) -> Option<f64> {
        match (link, other) {
            // The wider one of the two is a box.
            (Link::Forearm, other) => self.of(other).depth_in(&self.solid(Some(link))),
            (link, other) => self.of(Some(link)).depth_in(&self.solid(other)),
        }
    }

    /// The same as [`Self::of`], narrower where it can be.
    fn solid(&self, link: Option<Link>) -> Shape<f64> {
        let [upper_arm, forearm] = self.figures.half_box_m;
        match link {
            Some(Link::UpperArm) => self.boxed(Link::UpperArm, upper_arm),
            Some(Link::Forearm) => self.boxed(Link::Forearm, forearm),
            _ => self.of(link).capsule(),
        }
    }

    fn boxed(&self, link: Link, [wide_m, thick_m]: [f64; 2]) -> Shape<f64> {
        let [from, to] = self.links[link as usize].axis;
        let length_m = (to - from).norm();
        let along = (to - from) / length_m;
        Shape::OrientedBox(OrientedBox {
            centre: ((from + to) * 0.5).into(),
            half: [0.5 * length_m + wide_m, wide_m, thick_m],
            axes: [along, self.normal.cross(&along), self.normal].map(Into::into),
        })
    }
}

impl Held {
    fn capsule(&self) -> Shape<f64> {
        let [from, to] = self.axis;
        Shape::Capsule(Capsule { from: from.into(), along: (to - from).into(), radius: self.radius_m })
    }

    /// In the coordinates of a frame, given in its own.
    fn seen_from(&self, frame: &Pose) -> Self {
        Self { axis: self.axis.map(|end| frame.tool_from_world(&end)), ..*self }
    }

    /// How deep it is in a solid; none if it is not.
    fn depth_in(&self, solid: &Shape<f64>) -> Option<f64> {
        let [from, to] = self.axis;
        let at = |share: f64| solid.distance_at((from + (to - from) * share).into()) - self.radius_m;
        let nearest_m = least(at, (to - from).norm(), 0.0);
        (nearest_m < 0.0).then_some(-nearest_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::{Mount, Surroundings};
    use crate::scene::Scene;
    use powderline_shared::arm::inverse::Posture;
    use powderline_shared::pose::exp_so3;
    use proptest::prelude::*;
    use std::collections::BTreeSet;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn model(kind: ArmKind) -> ArmModel {
        ArmModel::new(kind, Pose::identity(), Pose::identity(), Posture::PREFERRED[0])
    }

    fn to_line_m(point: Vector3<f64>, [from, to]: [Vector3<f64>; 2]) -> f64 {
        let along = to - from;
        let share = ((point - from).dot(&along) / along.dot(&along)).clamp(0.0, 1.0);
        (point - from - along * share).norm()
    }

    /// From a point to the box around a line in a plane; 0 within it.
    fn to_box_m(
        point: Vector3<f64>,
        [from, to]: [Vector3<f64>; 2],
        normal: Vector3<f64>,
        [wide_m, thick_m]: [f64; 2],
    ) -> f64 {
        let (length_m, along, from_start) = ((to - from).norm(), (to - from).normalize(), point - from);
        let beyond = |axis: Vector3<f64>, low: f64, high: f64| {
            let at = from_start.dot(&axis);
            at - at.clamp(low, high)
        };
        let across = normal.cross(&along);
        Vector3::new(
            beyond(along, -wide_m, length_m + wide_m),
            beyond(across, -wide_m, wide_m),
            beyond(normal, -thick_m, thick_m),
        )
        .norm()
    }

    /// The least over many points of a line.
    fn least_m([from, to]: [Vector3<f64>; 2], at: impl Fn(Vector3<f64>) -> f64) -> f64 {
        (0..=1000).map(|k| at(from.lerp(&to, f64::from(k) * 1e-3))).fold(f64::INFINITY, f64::min)
    }

    /// Between a capsule and another part; nothing where the capsule's axis is in the part.
    fn gap_m(capsules: &Capsules, link: Link, other: Option<Link>) -> Option<f64> {
        if let (Link::Forearm, None) = (link, other) {
            let (held, line) = (capsules.of(None), capsules.of(Some(link)).axis);
            let half_m = capsules.figures.half_box_m[1];
            let nearest_m = least_m(held.axis, |point| to_box_m(point, line, capsules.normal, half_m));
            return (nearest_m > 0.0).then_some(nearest_m - held.radius_m);
        }
        let (held, part) = (capsules.of(Some(link)), capsules.of(other));
        let boxed = |half_m| least_m(held.axis, |point| to_box_m(point, part.axis, capsules.normal, half_m));
        let [upper_arm, forearm] = capsules.figures.half_box_m;
        let nearest_m = match other {
            Some(Link::UpperArm) => boxed(upper_arm),
            Some(Link::Forearm) => boxed(forearm),
            _ => least_m(held.axis, |point| to_line_m(point, part.axis)) - part.radius_m,
        };
        (nearest_m > 0.0).then_some(nearest_m - held.radius_m)
    }

    /// What `gap_m` may be off, metres.
    const OFF_M: f64 = 2e-3;

    fn kinds() -> impl Strategy<Value = ArmKind> {
        prop::sample::select(&ArmKind::ALL[..])
    }

    fn joints() -> impl Strategy<Value = Joints> {
        [-PI..PI, -PI..PI, -PI..PI, -PI..PI, -PI..PI, -PI..PI]
    }

    proptest! {
        #[test]
        fn parts_meet_where_they_overlap(kind in kinds(), joints in joints()) {
            let capsules = Capsules::at(kind, &joints);
            match contact(&model(kind), &joints, &[]) {
                Some(Contact { part: Part::Link(link), other, depth_m }) => {
                    let other = match other { Part::Link(other) => Some(other), _ => None };
                    if let Some(gap_m) = gap_m(&capsules, link, other) {
                        prop_assert!((gap_m + depth_m).abs() < OFF_M, "{link:?} {other:?} {gap_m} {depth_m}");
                    }
                }
                Some(contact) => prop_assert!(false, "there is no tool: {contact:?}"),
                None => for (link, other) in PAIRS {
                    let gap_m = gap_m(&capsules, link, other);
                    prop_assert!(gap_m.is_some_and(|gap_m| gap_m > -OFF_M), "{link:?} {other:?} {gap_m:?}");
                },
            }
        }
    }

    /// Each line of the table is there for a reason: some posture is refused for it.
    #[test]
    fn every_pair_can_meet() {
        let scene = Scene::load("bench").unwrap();
        let (mount, surroundings) =
            (Mount::of(scene.arm.as_ref().unwrap()), Surroundings::of_scene(&scene, -0.1));
        let mut seen = BTreeSet::new();
        let mut state = 1_u64;
        let mut angle = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5) * 2.0 * PI
        };
        // By brackets that reach back and aside.
        for bracket in [[0.2, 0.1, 0.05], [0.1, 0.0, -0.1], [0.0, 0.12, -0.05]] {
            let mut model = mount.model(Posture::PREFERRED[0]);
            model.flange_from_tool.position_m = bracket.into();
            for _ in 0..20_000 {
                let joints: Joints = std::array::from_fn(|_| angle());
                let capsules = Capsules::at(model.kind, &joints);
                let meet = PAIRS.iter().filter(|(link, other)| capsules.depth_m(*link, *other).is_some());
                seen.extend(meet.map(|pair| format!("{pair:?}")));
                if let Some(Contact { part: Part::Tool(_), other, .. }) =
                    contact(&model, &joints, surroundings.tool())
                {
                    seen.insert(other.to_string());
                }
            }
        }
        for pair in PAIRS {
            assert!(seen.contains(&format!("{pair:?}")), "{pair:?} never: {seen:?}");
        }
        for other in FROM_TOOL {
            let other = other.map_or(Part::Column, Part::Link).to_string();
            assert!(seen.contains(&other), "tool in {other} never: {seen:?}");
        }
    }

    /// Flange down, from near to far, high and low, as an arm before a bench works.
    #[test]
    fn an_arm_that_works_before_itself_is_free() {
        for kind in ArmKind::ALL {
            let (model, reach_m) = (model(kind), kind.figures().reach_m);
            let down = exp_so3(&(Vector3::x() * PI));
            for (far, high) in (5..=8).flat_map(|far| (-1..=4).map(move |high| (far, high))) {
                let [far, high] = [far, high].map(|tenths| 0.1 * reach_m * f64::from(tenths));
                let pose = Pose { position_m: Vector3::new(far, 0.1 * reach_m, high), orientation: down };
                if let Ok(joints) = model.joints_near(&[0.0; 6], &pose) {
                    assert_eq!(contact(&model, &joints, &[]), None, "{kind:?} {far} {high}");
                }
            }
        }
    }

    /// Wrist 2 along the forearm, its far end and the flange pointing away from it, and into it.
    #[test]
    fn a_wrist_that_is_folded_into_the_forearm_is_found_by_its_flange() {
        for kind in ArmKind::ALL {
            let folded = |q5| [0.0, -FRAC_PI_2, FRAC_PI_2, FRAC_PI_2, q5, 0.0];
            let [away, into] = [0.0, PI].map(|q5| contact(&model(kind), &folded(q5), &[]));
            assert_eq!(away, None, "{kind:?}");
            let into = into.map(|met| (met.part, met.other));
            assert_eq!(into, Some((Part::Link(Link::Wrist3), Part::Link(Link::Forearm))), "{kind:?}");
        }
    }

    /// A box is what a capsule is narrowed to, and no more: the same mesh is in both.
    #[test]
    fn boxes_are_narrower_than_capsules_and_not_by_much() {
        for figures in ArmKind::ALL.map(ArmKind::figures) {
            for (link, [wide_m, thick_m]) in figures.half_box_m.into_iter().enumerate() {
                let radius_m = figures.radius_m[link];
                assert!(wide_m < radius_m && wide_m > 0.5 * radius_m, "{wide_m} {radius_m}");
                assert!(
                    thick_m > 0.5 * radius_m && wide_m.hypot(thick_m) > 0.85 * radius_m,
                    "{thick_m} {radius_m}"
                );
            }
        }
    }

    #[test]
    fn a_contact_is_named() {
        // The elbow folded up, until the wrist is at the shoulder.
        let folded = [0.0, -FRAC_PI_2, 3.1, 0.0, FRAC_PI_2, 0.0];
        let met = contact(&model(ArmKind::Ur5e), &folded, &[]).unwrap();
        assert_eq!((met.part, met.other), (Part::Link(Link::Forearm), Part::Column));
        let sentence = format!("{} would {met}", met.part);
        assert!(sentence.starts_with("its forearm would pass through its base or shoulder, "), "{sentence}");
        assert!(sentence.ends_with(" mm deep"), "{sentence}");
    }
}
